;;; anmech: integration to a wanted accuracy of the result.
;;;
;;; A method of integration bounds the error of one step; what a user asks for is an error of the whole. So a motion is
;;; integrated twice, the second time with a tolerance ten times coarser, and both are compared where some steps of the
;;; coarser one end; if they differ by more than was asked for, both are done again with a finer tolerance.  The
;;; difference is the error of the coarser motion, and the finer one is handed out: the estimate is on the safe side.
;;; The first pass is a cheap one, where a coarser tolerance makes it so: what it finds tells the tolerance that the
;;; next one needs.
;;;
;;; Besides, the coarser one starts from the other neighbouring doubles wherever a given number had to be rounded, and
;;; its field sees every state, the time, and the entries of linear equations changed by one unit in the last place: so
;;; the estimate also holds what rounding does in the end.
;;;
;;; All that this asks of a method is a function (problem tolerance progress) that gives an integration; of one that
;;; goes step by step, its formula (integration.lisp).
;;;
;;; Entry points: ACCURATE-MOTION, MOTION-BY-FORMULA, ERROR-OF-TOLERANCE; TWO-DIGITS-ABOVE, *FINE*, *LOOKS-AGAIN*.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4;
;;; L. F. Shampine, Tolerance proportionality in ODE codes, Lecture Notes in Mathematics 1386 (1989) 118-136.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/doubles" "numerics/integration" "numerics/model"
       "numerics/motion" "numerics/progress" "numerics/steps" "numerics/unseen" "numerics/weights")

;;; Two integrations and their difference

(defstruct difference
  (error 0d0)                       ; the largest difference of a state, in units of its largest size so far
  parts                             ; of each state, the largest difference as it is
  good-until                        ; the last time until which it was below the wanted accuracy
  (good-error 0d0)                  ; the largest until then
  (rises '()))                      ; pairs of a time and the difference there, ten times the one before; the last first

(defparameter *few-steps* 40 "So many or fewer are compared between their ends, too.")
(defparameter *compared-steps* 50 "In so many parts of the way, at least, if steps are so many, something is compared.
More of them do not raise the estimates of twenty systems at five accuracies; half of them lowers some by half.")
(defparameter *most-skipped* 8 "So many steps make such a part at most.")
(defparameter *longer* 1.1d0 "A step that is so much longer than all before is compared within.")
(defparameter *much-longer* 1.5d0 "And one that is so much longer than the one before.")
(defparameter *compared-checkpoints* 16 "Where states are not kept, one of so many checkpoints is compared.")

(defun compared (fine coarse weights accuracy)
  "The difference of two integrations, where steps of the coarser one end: they are anywhere in steps of the finer one,
so its values there are compared, too.  Such a value costs more than a step, so of many steps most are skipped; if they
are few, and agree, one looks more often; and always in those that are longer than all before, or much longer than the
one before: where a state has died out, the steps grow beyond the range of the formula, and their ends alone are good."
  (let* ((count (step-count fine)) (few (<= count *few-steps*))
         (stride (max 1 (min *most-skipped* (floor count *compared-steps*))))
         (difference (unless (and few (ends-agree-p fine coarse weights accuracy))
                       (compared-sometimes fine coarse weights accuracy stride))))
    (if (and few (or (null difference) (<= (difference-error difference) accuracy)))
        (compared-often fine coarse weights accuracy)
        difference)))

(defun ends-agree-p (fine coarse weights accuracy)
  "Whether the last states do: so will the others, as a rule."
  (and (= (integration-time fine) (integration-time coarse))
       (<= (difference-of-ends fine coarse weights (zeros (length (integration-final fine)))) accuracy)))

(defun difference-of-ends (fine coarse weights differences)
  (largest-difference (integration-final fine) (integration-final coarse)
                      (map-doubles ((least (weights-least weights)) (size (integration-largest fine)))
                                   (max least size))
                      differences))

(defparameter *very-few-steps* 10 "So few or fewer are bounded by how they may grow, and by the end.")

(defun few-steps-p (integration)
  "Whether the steps of another tolerance would be nearly the same, and so would be what is read within them."
  (<= 1 (step-count integration) *very-few-steps*))

(defparameter *places-within* (list (/ 1d0 3) (/ 2d0 3)) "Where in a step two integrations are compared.")
(defparameter *places-within-long* '(0.5d0 0.75d0) "Where in one that is longer than those around.")

(defun times-in-step (integration place parts)
  (mapcar (lambda (part) (+ (aref (the double-array (integration-times integration)) place)
                            (* part (step-length integration place))))
          parts))

(defun checked-value (coarse time out)
  "The state of COARSE at TIME goes to OUT; nil where it has none: its step is taken again for that, and sees times that
are rounded otherwise, at the end perhaps beyond what a function is defined for."
  (handler-case (progn (dense-value coarse time out) t)
    ((or domain-violation arithmetic-error) () nil)))

(defun compared-often (fine coarse weights accuracy)
  "The same at the end of every step, and within, and in the middle of those of the finer one, as what is read of them
is worst there; doubled where the checking integration has taken shorter steps, so that it tells but the error itself."
  (let* ((n (length (integration-final fine)))
         (comparison (make-difference :good-until (integration-start fine) :parts (zeros n)))
         (state (zeros n)) (other (zeros n))
         (compare (comparing fine weights accuracy state other comparison
                             (if (few-steps-p fine) 2d0 1d0))))
    (declare (type function compare))
    (dolist (time (times-to-compare fine coarse))
      (when (checked-value coarse time other) (funcall compare time)))
    (compare-events comparison fine coarse weights accuracy)
    comparison))

(defun times-to-compare (fine coarse)
  (let* ((start (integration-start fine)) (forward (>= (integration-time fine) start))
         (earlier (if forward #'< #'>))
         (end (first (sort (list (integration-time fine) (integration-time coarse)) earlier))))
    (remove-if (lambda (time) (funcall earlier end time))
               (sort (append (loop for place below (step-count coarse)
                                   append (times-in-step coarse place *places-within*)
                                   collect (aref (the double-array (integration-times coarse)) (1+ place)))
                             (loop for place below (step-count fine) append (times-in-step fine place '(0.5d0))))
                     earlier))))

(defparameter *longer-than-near* 1.15d0 "A step that is so much longer than its neighbours is compared within.")
(defparameter *most-compared-within* 24 "So many of these, those that are longest beside them.")

(defun times-in-long-steps (fine coarse)
  "Times within steps of FINE that are longer than those around, in their order, as far as COARSE goes: there the
estimate of the error of a step was small by chance, and what is read within may be much worse than the end."
  (let* ((times (integration-times fine)) (found '()) (end (integration-time coarse))
         (earlier (if (>= (integration-time fine) (integration-start fine)) #'< #'>)))
    (declare (type (simple-array double-float (*)) times))
    (unless (integration-implicit fine)
      (with-fast-arithmetic
        (for (place (- (step-count fine) 2) 2)
          (let ((ratio (flo (/ (* 4d0 (- (aref times (fix (+ place 1))) (aref times place)))
                               (+ (- (aref times place) (aref times (fix (- place 2))))
                                  (- (aref times (fix (+ place 3))) (aref times (fix (+ place 1)))))))))
            (declare (double-float ratio))
            (when (> ratio (the double-float *longer-than-near*)) (push (cons ratio place) found))))))
    (remove-if (lambda (time) (funcall earlier end time))
               (sort (loop for (nil . place) in (sort found #'> :key #'car)
                           repeat *most-compared-within*
                           append (times-in-step fine place *places-within-long*))
                     earlier))))

(defun bounded-by-stability-p (fine coarse)
  "Whether that bounds steps of either: then they may be alike in both, the ends of one always near those of the other,
which are good, while what is read within is worse than the tolerance by orders of magnitude."
  (and (not (integration-implicit fine))
       (or (integration-stiffness fine) (integration-stiffness coarse))))

(defun compared-sometimes (fine coarse weights accuracy stride)
  "The same at the end of every one of STRIDE steps, and twice in those that are longer, of either."
  (let* ((n (length (integration-final fine)))
         (comparison (make-difference :good-until (integration-start fine) :parts (zeros n)))
         (state (zeros n))
         (other (zeros n))
         (compare (comparing fine weights accuracy state other comparison))
         (times (integration-times coarse))
         (end (integration-time fine))
         (forward (>= end (integration-start fine)))
         (long (times-in-long-steps fine coarse))
         (bounded (bounded-by-stability-p fine coarse))
         (longest 0d0) (previous 0d0))
    (declare (type (simple-array double-float (*)) times state other) (type function compare)
             (double-float end longest previous))
    (labels ((beyond (time) (if forward (> time end) (< time end)))
             (long-before (time)
               (loop while (and long (if forward (<= (first long) time) (>= (first long) time)))
                     collect (pop long)))
             (compare-within (place all)
               (let ((found (long-before (aref times (1+ place))))
                     (others (and all (times-in-step coarse place *places-within*))))
                 (when (or found others)
                   (dolist (time (merge 'list found others (if forward #'< #'>)))
                     (unless (beyond time)
                       (when (checked-value coarse time other) (funcall compare time))))))))
      (loop for last = 0 then place
            for place = (next-compared coarse last stride)
            while (> place last)
            do (for (step place last)
                 (let ((length (flo (abs (- (aref times (fix (+ step 1))) (aref times step))))))
                   (declare (double-float length))
                   (compare-within step
                                   (or (and bounded (= step last))
                                       (and (> step (the fixnum *few-steps*))       ; the first ones only grow
                                            (or (> length (flo (* (the double-float *longer*) longest)))
                                                (> length (flo (* (the double-float *much-longer*) previous)))))))
                   (setq longest (flo (max longest length))
                         previous length)))
               (when (beyond (aref times place)) (return))
               (state-of-step coarse place other)
               (funcall compare (aref times place))))
    (compare-events comparison fine coarse weights accuracy)
    comparison))

(defun next-compared (integration place stride)
  "Where to compare after PLACE: STRIDE steps later, or where a checkpoint is, or at the end."
  (let* ((kept (states-kept integration)) (far (* *replayed* *compared-checkpoints*)) (next (+ place stride)))
    (min (step-count integration)
         (if (or (<= next kept) (null (integration-states integration)))
             next
             (+ kept (* far (ceiling (- next kept) far)))))))

(defun comparing (fine weights accuracy state other comparison &optional (factor 1d0))
  "A function (time), to be called with later and later times when OTHER holds the state of another integration there:
notes in COMPARISON how far FINE is from it, times FACTOR.  It is measured by the largest sizes of the states of FINE up
to the end of the step that it is in: what grows from 0 is not asked for digits of what it is within a step."
  (let* ((largest (copy-seq (weights-least weights)))
         (grains (weights-grains weights))
         (times (integration-times fine))
         (states (integration-states fine))
         (differences (difference-parts comparison))
         (forward (>= (integration-time fine) (integration-start fine)))
         (seen 0) (place 0))
    (declare (fixnum seen place))
    (lambda (time)
      (loop until (or (null grains) (if forward (> (caar grains) time) (< (caar grains) time)))
            do (raise-sizes largest (cdr (pop grains)) 0 1 (/ *noise* accuracy)))
      (setq place (step-place-from times place time))
      (when states
        (let ((end (min (+ place 2) (states-kept fine))))
          (raise-sizes largest states seen end 1d0)
          (setq seen (max seen end))))
      (value-in-step fine place time state)
      (note-difference comparison time (* factor (largest-difference state other largest differences)) accuracy))))

(defun compare-events (comparison fine coarse weights accuracy)
  "Where an event has ended one of the integrations, the same is to have ended the other: then the states there are
compared, too.  If not, all that one of them has gone farther is unknown."
  (let* ((event (integration-ended-by fine)) (other (integration-ended-by coarse))
         (end (integration-time fine)) (way (abs (- end (integration-start fine)))))
    (when (or event other)
      (note-difference comparison end
                       (if (and event other (eql (event-number event) (event-number other)))
                           (difference-of-ends fine coarse weights (difference-parts comparison))
                           (min 1d0 (/ (abs (- end (integration-time coarse))) (max way 1d-300))))
                       accuracy))))

(defun note-difference (comparison time difference accuracy)
  (when (> difference (difference-error comparison))
    (setf (difference-error comparison) difference)
    (when (> difference (* 10 (or (cdr (first (difference-rises comparison))) 1d-18)))
      (push (cons time difference) (difference-rises comparison))))
  (unless (> (difference-error comparison) accuracy)
    (setf (difference-good-until comparison) time
          (difference-good-error comparison) (difference-error comparison))))

(defun joined-differences (first second)
  (let ((sooner (if (> (difference-error first) (difference-error second)) first second)))
    (make-difference :error (max (difference-error first) (difference-error second))
                     :parts (map-doubles ((a (difference-parts first)) (b (difference-parts second))) (max a b))
                     :good-until (difference-good-until sooner)
                     :good-error (max (difference-good-error first) (difference-good-error second))
                     :rises (difference-rises sooner))))

(defun growth-of-difference (comparison)
  "r, if the difference grows by exp(r t) over six powers of ten and more, half of them in about half of the time; nil
otherwise."
  (let* ((rises (difference-rises comparison)) (count (length rises)))
    (when (>= count 6)
      (let* ((last (first rises)) (middle (nth (floor count 2) rises)) (start (first (last rises)))
             (span (abs (- (car last) (car start)))))
        (when (and (plusp span) (< 0.25d0 (/ (abs (- (car middle) (car start))) span) 0.75d0))
          (/ (log (/ (cdr last) (cdr start))) span))))))

;;; Rounding

(defun noise-factors (start other n direction)
  "By what a field sees every state changed: a unit in the last place, in the direction, if there is one, from START to
OTHER, where the same is rounded otherwise; or, if DIRECTION is -1, in the opposite one."
  (let ((factors (zeros n)))
    (dotimes (i n factors)
      (let* ((difference (- (abs (aref other i)) (abs (aref start i))))
             (side (if (or (plusp difference) (and (zerop difference) (evenp i))) 1 -1)))
        (setf (aref factors i) (+ 1d0 (* 2.3d-16 direction side)))))))

(defun noisy-field (field factors size)
  "FIELD, whose input has SIZE numbers, with the states multiplied by FACTORS, and the time moved by at most a unit in
the last place, at random: as it is rounded, too."
  (declare (type function field) (type (simple-array double-float (*)) factors) (fixnum size))
  (let ((n (length factors)) (seen (zeros size)) (seed 1))
    (declare (type (simple-array double-float (*)) seen) (fixnum n seed))
    (lambda (in out)
      (declare (type (simple-array double-float (*)) in out))
      (with-fast-arithmetic
        (let ((seen seen) (factors factors) (n n) (size size) (new-seed seed))          ; a closure reads anew each time
          (declare (type (simple-array double-float (*)) seen factors) (fixnum n size new-seed))
          (for (i n) (setf (aref seen i) (flo (* (aref factors i) (aref in i)))))
          (for (i size n) (setf (aref seen i) (aref in i)))
          (setq new-seed (the fixnum (logand 65535 (the fixnum (+ 13849 (the fixnum (* 25173 new-seed))))))
                seed new-seed)
          (setf (aref seen n) (flo (* (aref seen n)
                                      (+ 1d0 (if (< new-seed 22000) -2.3d-16 (if (< new-seed 44000) 0d0 2.3d-16))))))
          (funcall field seen out)
          nil)))))

(defun longest-to-check (integration longest)
  "The longest step that an integration may take that checks INTEGRATION, whose longest is LONGEST: nil or a number."
  (if (few-steps-p integration)
      (* 0.6d0 (loop for place below (step-count integration) maximize (abs (step-length integration place))))
      longest))

(defun noisy-problem (problem other direction from fine)
  "PROBLEM with the noise of the direction that leads from its start to OTHER, begun at FROM; as far as the integration
FINE has come, if that ended on the way: beyond an obstacle it would go astray."
  (let ((factors (noise-factors (problem-start problem) other (problem-n problem) direction))
        (noisy (copy-problem problem)))
    (let* ((model (problem-model problem))
           (smooth (noisy-field (noisy-smooth-field model direction) factors (length from))))
      (setf (problem-field noisy) (field-finding-sides smooth model)
            (problem-smooth-field noisy) (and (problem-surfaces problem) smooth)))
    (setf (problem-start noisy) from
          (problem-end noisy)
          (if (or (obstacle-p fine) (given-up-p fine)) (integration-time fine) (problem-end problem))
          (problem-patience noisy) nil
          (problem-whole noisy) (if (> (step-count fine) *few-steps*) 0 *few-steps*)
          ;; what the finer integration has only touched ends none; the rest of the way is verified, too
          (problem-events noisy) (and (integration-ended-by fine) (problem-events problem))
          (problem-longest noisy) (longest-to-check fine (problem-longest problem))
          (problem-noise noisy) factors)
    (with-breakpoints noisy (middles-between-breakpoints problem fine))))

(defun middles-between-breakpoints (problem fine)
  "Of steps of FINE that lead from one breakpoint to the next: the check would take the same one, and err as it does."
  (when (problem-breakpoints problem)
    (let ((breakpoints (make-hash-table :test #'eql)) (times (integration-times fine)))
      (dolist (time (problem-breakpoints problem)) (setf (gethash time breakpoints) t))
      (loop for place from 0 below (step-count fine)
            for from = (aref times place)
            for to = (aref times (1+ place))
            when (and (gethash from breakpoints) (gethash to breakpoints)) collect (* 0.5d0 (+ from to))))))

;;; Passes

(defparameter *most-steps* 4000000 "How many an integration takes, if its user says nothing.")
(defparameter *finest* 5d-16 "The finest tolerance that makes sense.")
(defparameter *fine* 1d-14 "A tolerance from which on rounding matters.")
(defparameter *attainable* 1d-14 "Differences are not looked at more closely.")

(defun coarser (tolerance)
  "The tolerance of the second integration; near the finest possible, less is left between both."
  (* tolerance (if (<= tolerance *finest*) 4d0 10d0)))

(defparameter *whole-steps* 100 "Of so many first steps the states within are computed at once: if they are not many
more, all are compared.")

(defun motion-of-pass (task method tolerance weights expected progress)
  "Integrate with TOLERANCE and, to verify, with a coarser one: a motion, what was seen in comparing, better weights.
Nothing was seen, nil, where an interruption has kept them from being compared.  EXPECTED: the difference that the pass
before lets expect, or nil."
  (let* ((problem (compared-problem task)) (start (problem-start problem))
         (fine (funcall method problem
                        (if (scouting-p task tolerance)
                            (scouting-tolerance (growing-tolerance weights tolerance problem) problem)
                            (growing-tolerance weights tolerance problem))
                        (telling progress "")))
         (verify (and (task-verify task) (not (interrupted-p))))
         ;; near an obstacle sizes may be anything
         (weights (if (and verify (not (obstacle-p fine)))
                      (renewed-weights problem fine weights (task-accuracy task))
                      weights))
         (motion (make-motion :model (problem-model problem) :integration fine :start start
                              :reached (integration-time fine) :evaluations (integration-evaluations fine))))
    (flet ((comparison (from tolerance direction)
             (let* ((noisy (noisy-problem problem (task-other-start task) direction from fine))
                    (coarse (funcall method (with-steps-of noisy fine) (growing-tolerance weights tolerance noisy)
                                     (telling progress "check of "))))
               (incf (motion-evaluations motion) (integration-evaluations coarse))
               (unless (and (interrupted-p) (zerop (step-count coarse)))
                 (when (given-up-p coarse) (cut-short motion coarse))
                 (settled-difference problem fine coarse weights (max *attainable* (task-accuracy task)))))))
      (let ((comparison (cond (verify (comparison (task-other-start task) (coarser tolerance) 1))
                              ((task-verify task) nil)
                              (t (make-difference :good-until (integration-time fine)
                                                  :parts (zeros (problem-n problem)))))))
        (when (and verify comparison
                   (or (< tolerance *fine*)
                       (and (= tolerance *fine*)
                            (not (and (<= (difference-error comparison) (task-accuracy task))
                                      (falls-as-expected-p comparison expected))))))
          (let ((other (comparison start (* 1.5d0 tolerance) -1)))
            (when other
              (setq comparison (if (falls-as-expected-p comparison expected)
                                   (difference-of-two comparison other (task-accuracy task))
                                   (joined-differences comparison other))))))
        (values motion comparison (if (and verify comparison (obstacle-p fine))
                                      (measured-weights problem fine (difference-good-until comparison))
                                      weights))))))

(defun scouting-p (task tolerance)
  "Whether a motion of TOLERANCE will not be handed out: it only tells what is needed."
  (and (task-verify task)
       (= tolerance (first-tolerance (task-accuracy task)))
       (> tolerance (/ (task-accuracy task) 10))))

(defparameter *scouting-steps* 1000)

(defun scouting-tolerance (tolerance problem)
  "TOLERANCE for an integration that ends when the later half of many steps has hardly come on: one so coarse may go
astray near a singularity, and crawl."
  (let* ((observer (tolerance-observer tolerance)) (n (problem-n problem)) (start (problem-time problem))
         (before start) (count 0) (next *scouting-steps*))
    (declare (type function observer) (fixnum n count next))
    (setf (tolerance-observer tolerance)
          (lambda (in)
            (funcall observer in)
            (when (= (incf count) next)
              (let* ((time (aref (the double-array in) n))
                     (crawls (< (abs (- time before)) (* 1d-3 (abs (- time start))))))
                (setq before time next (* 2 next))
                (and crawls :crawling)))))
    tolerance))

(defun falls-as-expected-p (comparison expected)
  "Whether the difference is what a tolerance so much finer makes of that of the pass before, by its power: where
rounding governs it is one of chance, and two are better than one."
  (and expected (<= (difference-error comparison) (* 2 expected))))

(defun difference-of-two (comparison other accuracy)
  "What is known where the first difference has fallen with the tolerance, whose finer integration errs by a tenth of
it; OTHER is that from an integration nearly as fine, with the opposite noise.  As long as that brings the accuracy."
  (let ((error (max (/ (difference-error comparison) 3) (* 2 (difference-error other)))))
    (if (<= error accuracy)
        (make-difference :error error :good-error error :good-until (difference-good-until other)
                         :parts (map-doubles ((first (difference-parts comparison)) (second (difference-parts other)))
                                             (max (/ first 3d0) (* 2d0 second))))
        (joined-differences comparison other))))

(defun compared-problem (task)
  "That of the integration that is handed out."
  (let ((problem (task-problem task)))
    (setf (problem-whole problem) (if (task-verify task) *whole-steps* 0))
    problem))

(defun with-steps-of (problem integration)
  "PROBLEM, for which some more steps than INTEGRATION has tried are worth taking: one of a coarser tolerance that needs
more has gone astray behind a singularity, where it may crawl."
  (setf (problem-most-steps problem)
        (+ 1000 (* 4 (+ (integration-accepted integration) (integration-rejected integration)))))
  problem)

(defun interrupted-pass-p (motion comparison)
  "Whether an interruption has kept MOTION from being compared all along."
  (and (interrupted-p) (or (null comparison) (cut-short-p motion))))

(defun cut-short-p (motion)
  (/= (motion-reached motion) (integration-time (motion-integration motion))))

(defun cut-short (motion check)
  "Give MOTION only as far as the integration CHECK has come, and say so."
  (setf (motion-reached motion) (integration-time check)
        (motion-message motion) (if (interrupted-p)
                                    (integration-message check)
                                    (format nil "the integration that checks ended at time ~a: ~a"
                                            (maxima-text (integration-time check)) (integration-message check)))))

(defun settled-difference (problem fine coarse weights accuracy)
  "Their difference in sizes that states have had where it is small: beyond, where a motion ends, they may be anything."
  (let ((difference (compared fine coarse weights accuracy)))
    (when (obstacle-p fine)
      (loop repeat 5
            for until = (difference-good-until difference)
            do (setq difference (compared fine coarse (measured-weights problem fine until) accuracy))
            until (= until (difference-good-until difference))))
    difference))

(defun given-up-p (integration)
  "Whether it could go on."
  (member (integration-status integration) '(:interrupted :too-many-steps :stiff :crawling)))

(defun obstacle-p (integration)
  "Whether it ends early because it cannot go on."
  (and (integration-message integration) (not (given-up-p integration))))

(defparameter *telling* 0.1d0 "A larger error than this tells little of what a finer tolerance will bring.")

(defun expected-error (tolerance previous-error previous-tolerance)
  "What the error should be if it falls as the tolerance does; nil if there was no pass before that could tell."
  (and previous-error
       (< previous-error *telling*)
       (* previous-error (/ (coarser tolerance) (coarser previous-tolerance)))))

(defun rounding-limited-p (error tolerance expected)
  "Whether the error has not fallen as the tolerance has: then rounding governs it."
  (and expected (<= tolerance *fine*) (> error (* 2 expected))))

(defun first-tolerance (accuracy)
  "Of a pass that costs little and finds how much larger the error of a motion is than that of a step."
  (max (/ accuracy 10) (min 1d-5 (expt (/ accuracy 10) 0.6d0)) *finest*))

(defparameter *aim* 0.1d0
  "The part of the wanted error that a finer tolerance is to bring: one pass more costs more than finer steps.")

(defun next-tolerance (tolerance ratio)
  "A finer tolerance, where RATIO is the wanted error by that which was found.  Near the finest, where steps cost most,
no more is aimed at than what is wanted; short of it a stop is made, unless that is clearly not enough."
  (let ((enough (* tolerance (min 0.1d0 ratio))) (aimed (* tolerance (min 0.1d0 (* *aim* ratio)))))
    (cond ((>= aimed *fine*) aimed)
          ((and (> tolerance (* 2 *fine*)) (> (* 5 enough) *fine*)) *fine*)
          ((< enough (* 5 *finest*)) *finest*)
          (t (min *fine* (* 0.7d0 enough))))))

(defparameter *told* 0.3d0
  "A smaller part of the tolerance, as an error, is due to the few steps that it was found in: it does not tell what
finer ones make.")

(defun told-error (error tolerance accuracy weights motion)
  "What ERROR tells of finer tolerances: where they would meet with rounding, no more is taken than is necessary."
  (if (clear-of-noise-p accuracy weights (integration-largest (motion-integration motion)))
      (max error (* *told* tolerance))
      error))

(defparameter *usual-ratio* 2.5d-5 "What the next tolerance is finer by where an error tells nothing.")

(defun wanted-ratio (motion comparison error accuracy)
  "The wanted error by that which was found; near obstacles, where that tells nothing, a usual one."
  (let ((obstacle (or (cut-short-p motion) (obstacle-p (motion-integration motion)))))
    (cond ((not obstacle)
           (/ accuracy (max error (if comparison (error-to-come comparison (motion-integration motion)) 0d0) 1d-300)))
          ((cut-short-p motion) *usual-ratio*)
          (t (max *usual-ratio* (/ accuracy (max error 1d-300)))))))

(defun error-to-come (comparison integration)
  "What the difference would be if it were not bounded by the sizes of the states: from where it was small it has grown
like the square of time, as a phase does whose rate drifts."
  (let ((error (difference-error comparison))
        (small (find-if (lambda (rise) (<= (cdr rise) (* 0.1d0 *telling*))) (difference-rises comparison)))
        (way (abs (- (integration-time integration) (integration-start integration)))))
    (if (and small (> error *telling*) (/= (car small) (integration-start integration)))
        (max error (* (cdr small) (expt (/ way (abs (- (car small) (integration-start integration)))) 2)))
        error)))

(defun motion-trouble (motion)
  "The sentence that says why it ends early, or nil."
  (integration-message (motion-integration motion)))

(defun unfinished-p (motion) (given-up-p (motion-integration motion)))

(defun better-p (motion comparison error tolerance best seen least)
  "Whether a later motion is to be preferred: it is the finer one; only where rounding matters the error decides, and if
that tells nothing, or one was not compared to its end, the time until which it holds.  One that meets with an obstacle
looks closer than those before."
  (cond ((null best) t)
        ((and (unfinished-p motion) (not (unfinished-p best))) nil)
        ((hopeless-p motion comparison best) nil)
        ((or (motion-trouble motion) (motion-trouble best) (> tolerance *fine*)) t)
        ((or (and (<= (min error least) *telling*) (not (cut-short-p motion)) (not (cut-short-p best)))
             (= (difference-good-until comparison) (difference-good-until seen)))
         (< error least))
        (t (> (way-until comparison motion) (way-until seen best)))))

(defun hopeless-p (motion comparison best)
  "Whether a tolerance was too fine for a single step, of a motion that was followed to the end before."
  (and best (obstacle-p (motion-integration motion)) (not (motion-trouble best)) (zerop (way-until comparison motion))))

(defun tolerance-between (too-fine tolerance)
  "One that is finer than TOLERANCE, but not as TOO-FINE; nil if these are near one another."
  (cond ((< too-fine *fine* tolerance) *fine*)
        ((< (* 100 too-fine) tolerance) (sqrt (* too-fine tolerance)))))

(defun way-until (comparison motion)
  (abs (- (difference-good-until comparison) (integration-start (motion-integration motion)))))

(defun last-pass-p (motion comparison error seen-error accuracy tolerance previous-error previous-end stalls)
  (cond ((<= tolerance *finest*) t)
        ((eq :crawling (integration-status (motion-integration motion))) nil)
        ((obstacle-p (motion-integration motion))
         (or (<= tolerance *fine*) (same-obstacle-p motion (difference-good-until comparison) previous-end)))
        ((and (cut-short-p motion) (not (unfinished-p motion))) nil)    ; a finer check may come further
        (t (or (<= error accuracy)
               (and previous-error (<= tolerance *fine*) (< (* 0.5d0 previous-error) seen-error))
               (and stalls (stalled-p seen-error tolerance previous-error))))))

(defun stalled-p (error tolerance previous-error)
  "Whether an error has hardly fallen with the tolerance, which has by ten at least: it is one of chance; where the
field depends on time the rounding of late times governs it; but an error of the size of the motion itself tells
nothing, nor does one below the tolerance, which a few steps that are as long as they can be make."
  (and previous-error (< error 1d-3) (< (* 0.3d0 previous-error) error) (< (coarser tolerance) error)))

(defun same-obstacle-p (motion good-until previous-end)
  "Whether a motion ends where the one before did, and is good nearly up to there."
  (let* ((end (motion-reached motion))
         (way (abs (- end (integration-start (motion-integration motion))))))
    (and previous-end
         (<= (abs (- end previous-end)) (* 1d-5 way))
         (<= (abs (- end good-until)) (* 1d-4 way)))))

(defparameter *coarse* 3d-6
  "Where no more is asked for, steps are few, and as long in both integrations where kinks or stability bound them: the
finer one errs by more than a tenth of the difference.")

(defun accurate-motion (task method &optional (first (first-tolerance (task-accuracy task))))
  "The motion of TASK by METHOD, a function as above; FIRST is the tolerance of the first pass."
  (let* ((accuracy (task-accuracy task)) (verify (task-verify task)) (progress (task-progress task))
         (weights (first-weights (task-problem task)))
         (tolerance (if verify first (max (/ accuracy 10) *finest*)))
         (best nil) (least nil) (seen nil) (evaluations 0) (previous-error nil) (previous-tolerance nil)
         (previous-end nil) (by-chance nil) (interrupted nil))
    (loop for pass from 1
          do (multiple-value-bind (motion comparison better-weights)
                 (motion-of-pass task method tolerance weights
                                 (expected-error tolerance previous-error previous-tolerance)
                                 (and progress (progress-of-pass progress pass)))
               (let* ((seen-error (if comparison (difference-error comparison) 0d0))
                      (expected (expected-error tolerance previous-error previous-tolerance))
                      (chance (or (stalled-p seen-error tolerance previous-error)
                                  (and by-chance comparison (not (falls-as-expected-p comparison expected)))))
                      (error (cond ((or chance (rounding-limited-p seen-error tolerance expected)) (* 3 seen-error))
                                   ((>= accuracy *coarse*) (* 2 seen-error))
                                   (t seen-error)))
                      (too-fine (hopeless-p motion comparison best)))
                 (when (interrupted-pass-p motion comparison)
                   (incf evaluations (motion-evaluations motion))
                   (if best
                       (setq interrupted (motion-reached motion))
                       (setq best motion least error seen comparison))
                   (return))
                 (incf evaluations (motion-evaluations motion))
                 (when (better-p motion comparison error tolerance best seen least)
                   (setq best motion least error seen comparison))
                 (when (or (not verify)
                           (if too-fine
                               (not (tolerance-between tolerance previous-tolerance))
                               (last-pass-p motion comparison error seen-error accuracy tolerance previous-error
                                            previous-end
                                            ;; once may be luck of the coarser of few steps
                                            (and by-chance (problem-timed (task-problem task))))))
                   (return))
                 (when (eq :stiff (integration-status (motion-integration motion)))
                   (setf (problem-stiffness (task-problem task)) (integration-stiffness (motion-integration motion))))
                 (if too-fine
                     (setq tolerance (tolerance-between tolerance previous-tolerance))
                     (setq weights better-weights
                           by-chance chance
                           previous-end (motion-reached motion)
                           previous-error seen-error
                           previous-tolerance tolerance
                           tolerance (next-tolerance tolerance
                                                     (wanted-ratio motion comparison
                                                                   (told-error error tolerance accuracy weights motion)
                                                                   accuracy)))))))
    (finish-motion best seen least task)
    (when interrupted
      (setf (motion-message best) (sentences (format nil "interrupted at time ~a of a finer integration"
                                                     (maxima-text interrupted))
                                             (motion-message best))))
    (setf (motion-evaluations best) evaluations)
    (hasten-field (motion-model best) evaluations)
    best))

(defparameter *looks-again* 3 "How often a motion is integrated again because something was stepped over.")

(defun method-of-formula (task formula)
  "The function that integrates problems of TASK by steps of FORMULA, or of that which it makes for a tolerance."
  (let ((most (or (task-max-steps task) *most-steps*)))
    (lambda (problem tolerance progress)
      (integrate-by-steps (if (functionp formula) (funcall formula tolerance) formula)
                          problem tolerance (min most (or (problem-most-steps problem) most)) progress))))

(defparameter *patient-in-search* 1000 "So many steps that only stability bounds are taken to find what follows.")

(defun error-of-tolerance (task formula tolerance most-steps)
  "What steps of TOLERANCE by FORMULA make of the error of the motion of TASK, how many evaluations that took to find,
and that motion; the first is nil where MOST-STEPS do not lead to its end."
  (multiple-value-bind (motion comparison)
      (let ((problem (copy-problem (task-problem task))) (task (copy-task task)))
        (setf (problem-patience problem) *patient-in-search*
              (task-problem task) problem
              (task-max-steps task) most-steps)
        (motion-of-pass task (method-of-formula task formula) tolerance (first-weights problem) nil nil))
    (values (and comparison
                 (not (cut-short-p motion))
                 (eq :ok (integration-status (motion-integration motion)))
                 (plusp (difference-error comparison))
                 (difference-error comparison))
            (motion-evaluations motion)
            motion)))

(defun motion-by-formula (task formula &optional (first (first-tolerance (task-accuracy task))))
  "The motion of TASK by steps of FORMULA, or of that which the function FORMULA makes for a tolerance of the steps;
FIRST is the tolerance of the first pass."
  (let* ((method (method-of-formula task formula))
         (problem (task-problem task))
         (motion (accurate-motion task method first)))
    (when (and (problem-timed problem) (plusp (step-count (motion-integration motion))))
      (loop repeat *looks-again*
            for unseen = (unseen-times problem (motion-integration motion)
                                       (or (motion-error-estimate motion) (task-accuracy task)))
            while unseen
            do (let ((evaluations (motion-evaluations motion)))
                 (setq problem (with-breakpoints problem unseen)
                       task (copy-task task))
                 (setf (task-problem task) problem)
                 (setq motion (accurate-motion task method first))
                 (incf (motion-evaluations motion) evaluations))))
    motion))

;;; What is said of it

(defun finish-motion (motion comparison error task)
  "Note the estimate of the error, and say what is to be said.  A motion that ends at an obstacle is given as far as it
is accurate: where it ends, it need not be."
  (let* ((verify (task-verify task)) (accuracy (task-accuracy task)) (fine (motion-integration motion))
         (trouble (motion-trouble motion)))
    (cond ((null comparison)
           (setf (motion-message motion)
                 (format nil "~:[interrupted~;~:*~a~]: nothing is known of the error" trouble)))
          ((not verify) (setf (motion-message motion) trouble))
          ((obstacle-p fine)
           (setf (motion-reached motion) (difference-good-until comparison)
                 (motion-message motion) trouble
                 error (difference-good-error comparison)))
          (t (multiple-value-bind (state part) (state-in-doubt motion comparison error)
               (let ((missed (> error accuracy)))
                 (setq state (and (> part (* *known-sizes* (max error accuracy))) state)
                       error (if state part (max error (min part accuracy))))
                 (setf (motion-message motion)
                       (sentences (and trouble (given-up-sentence fine task))
                                  (motion-message motion)
                                  (and missed (accuracy-sentence fine comparison error accuracy))
                                  (and missed (late-times-sentence motion task))
                                  (and missed (small-states-sentence motion))
                                  (and state
                                       (format nil "~a is what much larger terms leave: rounding leaves ~a of it in ~
                                                    doubt"
                                               (typed-name state) (short-text part)))))))))
    (when (integration-ended-by fine)
      (setf (motion-message motion) (sentences (event-sentence fine) (motion-message motion))))
    (setf (motion-error-estimate motion) (and verify comparison (two-digits error)))))

(defun given-up-sentence (integration task)
  "Why, how far the motion was followed, and how many steps would be enough, if the others are as long."
  (let ((time (maxima-text (integration-time integration)))
        (needed (two-digits-above (steps-needed integration task))))
    (ecase (integration-status integration)
      (:too-many-steps
       (format nil "~d steps were not enough: the motion was followed to time ~a~@[; max_steps = ~d may be~]"
               (steps-of integration) time (and (< needed *conceivable-steps*) needed)))
      (:stiff
       (format nil "the equations are stiff: something decays at the rate ~a, which bounds the steps long after it ~
                    has died out: the motion was followed to time ~a; eliminate what decays so fast~@[, or give ~
                    max_steps = ~d and time~]"
               (short-text (cdr (integration-stiffness integration))) time
               (and (< needed *conceivable-steps*) needed))))))

(defparameter *conceivable-steps* 10000000000 "More would take days.")

(defun steps-of (integration)
  (+ (integration-accepted integration) (integration-rejected integration)))

(defun steps-needed (integration task)
  "How many would lead to the end, if all are as long; not more than anybody would take.  Exactly: the way may be as
long as a double can be."
  (let* ((begin (rational (integration-start integration)))
         (time (rational (integration-time integration)))
         (end (rational (problem-end (task-problem task)))))
    (min (* (steps-of integration) (if (= time begin) 1 (/ (- end begin) (- time begin))))
         (* 10 *conceivable-steps*))))

(defun event-sentence (integration)
  (let ((event (integration-ended-by integration)))
    (format nil "stopped by event ~d, ~a, at time ~a"
            (event-number event) (event-name event) (maxima-text (integration-time integration)))))

(defun two-digits-above (number)
  "An integer of two digits and noughts, not below 1.2 times NUMBER."
  (let ((unit (expt 10 (max 0 (- (floor (log (max number 10) 10)) 1)))))
    (* unit (ceiling (* 1.2d0 number) unit))))

(defparameter *small* 1d-290 "A smaller state cannot be followed to all digits: a part of it is no double any more.")

(defun small-states-sentence (motion)
  (let ((sizes (integration-largest (motion-integration motion))))
    (when (some (lambda (size) (< 0d0 size *small*)) sizes)
      (format nil "states below ~a are too small for doubles: state them in other units" (maxima-text *small*)))))

(defun late-times-sentence (motion task)
  "That late times are rounded, if this alone takes a good part of the accuracy in a step."
  (let* ((problem (task-problem task)) (integration (motion-integration motion)) (count (step-count integration))
         (time (integration-time integration)))
    (when (and (problem-timed problem) (plusp count)
               (> (abs time) (* 10 (abs (- time (integration-start integration))))))
      (let* ((step (abs (step-length integration (1- count))))
             (late (late-at problem (state-at motion time (copy-seq (motion-start motion))) step)))
        (when (some (lambda (rate size)
                      (> (* 10 *late-rounding* step rate) (* 0.3d0 (task-accuracy task) (max size 1d-300))))
                    (late-rates late) (integration-largest integration))
          (format nil "so late, times are rounded to multiples of ~a; let time begin at 0"
                  (short-text (spacing-at time))))))))

(defparameter *known-sizes* 2 "The sizes that errors count in are known up to such a factor.")

(defparameter *mere-noise* 1d-1 "What has a larger part of its size in error consists of nothing but rounding.")

(defun state-in-doubt (motion comparison error)
  "Errors count in units of the terms that rates consist of, where these are larger than the states: of states that are
what larger terms leave, fewer digits hold than ERROR says.  The one of which the fewest hold, or nil; and the part of
it that is in doubt, or ERROR."
  (let ((sizes (largest-sizes (motion-integration motion) (motion-dimension motion) nil)) (worst error) found)
    (loop for state in (model-states (motion-model motion))
          for size across sizes
          for difference across (difference-parts comparison)
          for part = (if (plusp size) (/ difference size) 0d0)
          do (when (and (< part *mere-noise*) (> part worst)) (setq worst part found state)))
    (values found worst)))

(defun accuracy-sentence (integration comparison error accuracy)
  (let ((growth (growth-of-difference comparison)) (until (difference-good-until comparison)))
    (format nil "the accuracy of ~a was not reached, only ~a~@[: it holds until time ~a~]~@[; the motion is sensitive, ~
                 errors grow by exp(~a*t)~]"
            (short-text accuracy) (short-text error)
            (and (/= until (integration-start integration)) (short-text until))
            (and growth (short-text growth)))))
