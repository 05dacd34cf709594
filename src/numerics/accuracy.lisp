;;; anmech: integration to a wanted accuracy of the result.
;;;
;;; A method of integration bounds the error of one step; what a user asks for is an error of the whole. So a motion is
;;; integrated twice, the second time with a tolerance ten times coarser, or more, and both are compared where some
;;; steps of the coarser one end; if they differ by more than was asked for, both are done again with a finer tolerance,
;;; or the second one alone, where the first is of the finest.  The difference is the error of the coarser motion, and
;;; the finer one is handed out: the estimate is on the safe side.  The first pass is a cheap one, where a coarser
;;; tolerance makes it so: what it finds tells the tolerance that the next one needs (passes.lisp).
;;;
;;; Besides, the coarser one starts from the other neighbouring doubles wherever a given number had to be rounded, and
;;; its field sees every state, the time, and the entries of linear equations changed by one unit in the last place: so
;;; the estimate also holds what rounding does in the end.  Where that governs, a third one with the opposite noise
;;; keeps a difference from being small by chance, unless three times the first one settle what can be said of a motion
;;; that is not sensitive.
;;;
;;; All that this asks of a method is a function (problem tolerance progress) that gives an integration; of one that
;;; goes step by step, its formula (integration.lisp).
;;;
;;; Entry points: ACCURATE-MOTION, MOTION-BY-FORMULA, ERROR-OF-TOLERANCE; TWO-DIGITS-ABOVE, *LOOKS-AGAIN*.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4;
;;; L. F. Shampine, Tolerance proportionality in ODE codes, Lecture Notes in Mathematics 1386 (1989) 118-136.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/comparison" "numerics/doubles"
       "numerics/integration" "numerics/model" "numerics/motion" "numerics/noise" "numerics/passes"
       "numerics/progress" "numerics/steps" "numerics/unseen" "numerics/weights")

;;; The check

(defun longest-to-check (integration longest)
  "The longest step that an integration may take that checks INTEGRATION, whose longest is LONGEST: nil or a number.  It
would take the same ones where they are few, or where most are as long as they may be."
  (let* ((steps (step-count integration))
         (way (abs (- (integration-time integration) (integration-start integration)))))
    (cond ((few-steps-p integration)
           (* 0.6d0 (abs (step-length integration (longest-step integration 0 steps)))))
          ((and longest (> (* 2 way) (* steps longest))) (* 0.6d0 longest))
          (t longest))))

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
    (with-breakpoints noisy (middles-of-pieces fine))))

(defparameter *steps-of-short-pieces* 3)

(defun middles-of-pieces (fine)
  "Of the longest steps of FINE in pieces between kinks or breakpoints that are few steps: the check would take nearly
the same ones, and err as they do.  Of an implicit method, whose pieces are parted anyway, the single steps."
  (let ((times (integration-times fine)) (begin 0) (middles '())
        (few (if (integration-implicit fine) 1 *steps-of-short-pieces*)))
    (flet ((piece-to (end)
             (when (<= 1 (- end begin) few)
               (let ((place (longest-step fine begin end)))
                 (push (* 0.5d0 (+ (aref times place) (aref times (1+ place)))) middles)))
             (setq begin end)))
      (when (plusp (length (integration-beginnings fine)))
        (map nil #'piece-to (integration-beginnings fine))
        (piece-to (step-count fine))))
    middles))

(defun longest-step (integration from to)
  "The place of the longest of the steps FROM to TO, not included."
  (let ((longest from))
    (loop for place from from below to
          do (when (> (abs (step-length integration place)) (abs (step-length integration longest)))
               (setq longest place)))
    longest))

;;; Passes

(defparameter *most-steps* 4000000 "How many an integration takes, if its user says nothing.")
(defparameter *attainable* 1d-14 "Differences are not looked at more closely.")

(defparameter *whole-steps* 100 "Of so many first steps the states within are computed at once: if they are not many
more, all are compared.")

(defun carry-out (pass task method progress)
  "Integrate with the tolerance of PASS and, to verify, with that of its check: what is found becomes its motion, what
was seen in comparing, and better weights.  Nothing was seen, nil, where an interruption has kept them from being
compared."
  (let* ((problem (compared-problem task))
         (fine (or (pass-kept pass) (fine-integration pass problem task method progress)))
         (verify (and (task-verify task) (not (interrupted-p)))))
    (setf (pass-motion pass) (make-motion :model (problem-model problem) :integration fine
                                          :start (problem-start problem) :reached (integration-time fine)
                                          :evaluations (if (pass-kept pass) 0 (integration-evaluations fine)))
          ;; near an obstacle sizes may be anything
          (pass-better-weights pass) (if (and verify (not (obstacle-p fine)))
                                         (renewed-weights problem fine (pass-weights pass) (task-accuracy task))
                                         (pass-weights pass))
          (pass-seen pass) (cond (verify (difference-in-pass pass task method progress))
                                 ((task-verify task) nil)
                                 (t (make-difference :good-until (integration-time fine)
                                                     :parts (zeros (problem-n problem))))))
    (when (and verify (pass-seen pass) (obstacle-p fine))
      (setf (pass-better-weights pass)
            (measured-weights problem fine (difference-good-until (pass-seen pass)))))
    pass))

(defun fine-integration (pass problem task method progress)
  (let ((tolerance (growing-tolerance (pass-weights pass) (pass-tolerance pass) problem)))
    (funcall method problem
             (if (scouting-p task (pass-tolerance pass)) (scouting-tolerance tolerance problem) tolerance)
             (telling progress ""))))

(defun difference-in-pass (pass task method progress)
  "That of the integration of PASS and its check, or of two of them; or nil."
  (let ((seen (checked pass (task-other-start task) (pass-check pass) 1 task method progress))
        (fine (motion-integration (pass-motion pass))) (expected (pass-expected pass)) (accuracy (task-accuracy task)))
    (cond ((null seen) nil)
          ((or (not (rounding-matters-p (pass-check pass)))
               (and (<= *fine* (pass-tolerance pass))
                    (<= (difference-error seen) accuracy)
                    (falls-as-expected-p seen expected)))
           seen)
          ((and (decides-alone-p seen accuracy pass) (not (obstacle-p fine)))
           (setf (difference-alone seen) t)
           seen)
          (t (let ((other (checked pass (problem-start (task-problem task)) (* 1.5d0 (pass-tolerance pass)) -1
                                   task method progress)))
               (cond ((null other) seen)
                     ((falls-as-expected-p seen expected) (difference-of-two seen other accuracy))
                     (t (joined-differences seen other))))))))

(defun checked (pass from tolerance direction task method progress)
  "The difference of the integration of PASS and one of a coarser TOLERANCE, begun at FROM, with the noise of DIRECTION;
nil where an interruption keeps them from being compared."
  (let* ((motion (pass-motion pass)) (fine (motion-integration motion)) (weights (pass-better-weights pass))
         (problem (task-problem task)) (accuracy (task-accuracy task))
         (noisy (noisy-problem problem (task-other-start task) direction from fine))
         (tolerance (growing-tolerance weights tolerance noisy))
         (coarse (funcall method (with-steps-of noisy fine) tolerance (telling progress "check of "))))
    (incf (motion-evaluations motion) (integration-evaluations coarse))
    (unless (and (interrupted-p) (zerop (step-count coarse)))
      (when (or (given-up-p coarse) (and (obstacle-p coarse) (ends-before-p coarse fine)))
        (cut-short motion coarse))
      (settled-difference problem fine coarse weights (max *attainable* accuracy)))))

(defun decides-alone-p (seen accuracy pass)
  "Whether a second difference would change nothing: the accuracy is reached, or missed, whatever it is, and a finer
pass follows."
  (let ((error (difference-error seen)) (expected (pass-expected pass)))
    (or (and (<= (* *doubt-of-one* error) accuracy)
             (or (not (sensitive-p (max error (or expected 0d0)) pass *very-sensitive*))
                 (and expected (<= (* *agreeing* expected) error))))
        (and (> error (* *doubt-of-one* accuracy)) (not (finest-p pass))))))

(defparameter *agreeing* 0.15d0 "A difference that is such a part of what was expected, or more, confirms it.")

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
more has gone astray behind a singularity, where it may crawl.  Breakpoints count as steps, too: where a piece that was
one step is taken in two, each of these may be taken in two, and be tried before."
  (setf (problem-most-steps problem)
        (+ 1000 (* 4 (+ (steps-of integration) (length (problem-breakpoints problem))))))
  problem)

(defun interrupted-pass-p (pass)
  "Whether an interruption has kept its motion from being compared all along."
  (and (interrupted-p) (or (null (pass-seen pass)) (cut-short-p (pass-motion pass)))))

(defun ends-before-p (coarse fine)
  "Whether COARSE has met with an obstacle where FINE, which leads to the end, has none; at the very end roundings may
make one."
  (and (not (obstacle-p fine))
       (> (abs (- (integration-time fine) (integration-time coarse)))
          (* 1d-6 (abs (- (integration-time fine) (integration-start fine)))))))

(defun cut-short (motion check)
  "Give MOTION only as far as the integration CHECK has come, and say so."
  (setf (motion-reached motion) (integration-time check)
        (motion-message motion) (if (interrupted-p) (integration-message check) (end-of-check check))))

(defun end-of-check (check)
  "The sentence for the time where the integration CHECK has ended; it may take fewer steps than others, WITH-STEPS-OF."
  (let ((time (maxima-text (integration-time check))))
    (if (eq :too-many-steps (integration-status check))
        (format nil "the integration that checks goes astray at time ~a, where it takes many times as many steps: ~
                     there may be a singularity, and beyond nothing is verified"
                time)
        (format nil "the integration that checks ended at time ~a: ~a" time (integration-message check)))))

(defun settled-difference (problem fine coarse weights accuracy)
  "Their difference in sizes that states have had where it is small: beyond, where a motion ends, they may be anything."
  (let ((difference (compared fine coarse weights accuracy)))
    (when (obstacle-p fine)
      (loop repeat 5
            for until = (difference-good-until difference)
            do (setq difference (compared fine coarse (measured-weights problem fine until) accuracy))
            until (= until (difference-good-until difference))))
    difference))

(defun accurate-motion (task method &optional (first (first-tolerance (task-accuracy task))) first-check)
  "The motion of TASK by METHOD, a function as above; FIRST is the tolerance of the first pass, and FIRST-CHECK that of
its check, of methods whose errors fall so much faster than costs grow that near the finest tolerance no other is worth
an integration."
  (let ((pass (first-pass task first first-check)) (before nil) (best nil) (evaluations 0) (interrupted nil))
    (loop for count from 1
          while pass
          do (carry-out pass task method (and (task-progress task) (progress-of-pass (task-progress task) count)))
             (judge-pass pass before (task-accuracy task))
             (incf evaluations (motion-evaluations (pass-motion pass)))
             (cond ((interrupted-pass-p pass)
                    (if best
                        (setq interrupted (motion-reached (pass-motion pass)))
                        (setq best pass))
                    (return))
                   ((hopeless-p pass best)
                    (setq pass (and (task-verify task) (pass-between pass before first-check))))
                   (t (if (better-p pass best) (setq best pass) (doubt-pass best pass))
                      (note-stiffness-of pass task)
                      (psetq pass (unless (or (not (task-verify task))
                                              (last-pass-p pass before (task-accuracy task)
                                                           (problem-timed (task-problem task))))
                                    (pass-after pass (task-accuracy task) first-check))
                             before pass))))
    (finished-motion best task evaluations interrupted)))

(defun note-stiffness-of (pass task)
  (let ((integration (motion-integration (pass-motion pass))))
    (when (eq :stiff (integration-status integration))
      (setf (problem-stiffness (task-problem task)) (integration-stiffness integration)))))

(defun finished-motion (pass task evaluations interrupted)
  "That of PASS, with all that is to be said of it.  INTERRUPTED: when a finer one was, or nil."
  (let ((motion (pass-motion pass)))
    (finish-motion motion (pass-seen pass) (pass-error pass) task)
    (when interrupted
      (setf (motion-message motion)
            (sentences (format nil "interrupted at time ~a of a finer integration" (maxima-text interrupted))
                       (motion-message motion))))
    (setf (motion-evaluations motion) evaluations)
    (hasten-field (motion-model motion) evaluations)
    motion))

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
  (let ((problem (copy-problem (task-problem task))) (task (copy-task task)))
    (setf (problem-patience problem) *patient-in-search*
          (task-problem task) problem
          (task-max-steps task) most-steps)
    (let* ((pass (carry-out (first-pass task tolerance nil) task (method-of-formula task formula) nil))
           (motion (pass-motion pass)) (seen (pass-seen pass)))
      (values (and seen
                   (not (cut-short-p motion))
                   (eq :ok (integration-status (motion-integration motion)))
                   (plusp (difference-error seen))
                   (difference-error seen))
              (motion-evaluations motion)
              motion))))

(defun motion-by-formula (task formula &optional (first (first-tolerance (task-accuracy task))) first-check)
  "The motion of TASK by steps of FORMULA, or of that which the function FORMULA makes for a tolerance of the steps;
FIRST and FIRST-CHECK as above."
  (with-infinities-of ((problem-model (task-problem task)))
    (motion-with-looks task (method-of-formula task formula) first first-check)))

(defun motion-with-looks (task method first first-check)
  "The same by METHOD; where something was stepped over, the motion is integrated again."
  (let* ((problem (task-problem task)) (motion (accurate-motion task method first first-check)))
    (when (and (problem-timed problem) (plusp (step-count (motion-integration motion))))
      (loop repeat *looks-again*
            for unseen = (unseen-times problem (motion-integration motion)
                                       (or (motion-error-estimate motion) (task-accuracy task)))
            while unseen
            do (let ((evaluations (motion-evaluations motion)))
                 (setq problem (with-breakpoints problem unseen)
                       task (copy-task task))
                 (setf (task-problem task) problem)
                 (setq motion (accurate-motion task method first first-check))
                 (incf (motion-evaluations motion) evaluations))))
    motion))

;;; What is said of it

(defparameter *half-unit* 1.11d-16 "No less is claimed of what moves: so much of a number is lost where it is rounded.")

(defun moved-p (motion)
  (let ((final (integration-final (motion-integration motion))))
    (mismatch final (the double-array (motion-start motion)) :end2 (length final))))

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
                                               (typed-name state) (short-text-of-error part)))))))))
    (when (integration-ended-by fine)
      (setf (motion-message motion) (sentences (event-sentence fine) (motion-message motion))))
    (setf (motion-error-estimate motion)
          (and verify comparison (two-digits (if (moved-p motion) (max error *half-unit*) error))))))

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
  (let ((growth (growth-of-difference comparison)) (until (difference-good-until comparison))
        (too-fine (< accuracy *attainable*)))              ; until when that holds was not looked at
    (format nil "the accuracy of ~a was not reached, only ~a~@[: it holds until time ~a~]~@[: doubles have no more ~
                 than 16 digits, digits = ~d computes so many~]~@[; the motion is sensitive, errors grow by exp(~a*t)~]"
            (short-text accuracy) (short-text-of-error error)
            (and (not too-fine) (/= until (integration-start integration)) (short-text until))
            (and too-fine (max 17 (ceiling (- (log accuracy 10)))))
            (and growth (short-text growth)))))
