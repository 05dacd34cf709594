;;; anmech: how far apart two integrations of one motion are.
;;;
;;; Entry points: the structure DIFFERENCE with MAKE-DIFFERENCE and its slots; COMPARED, DIFFERENCE-OF-ENDS,
;;; FEW-STEPS-P, *FEW-STEPS*, JOINED-DIFFERENCES, GROWTH-OF-DIFFERENCE.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/grazing" "numerics/integration" "numerics/weights")

(defstruct difference
  (error 0d0)                       ; the largest difference of a state, in units of its largest size so far
  parts                             ; of each state, the largest difference as it is
  good-until                        ; the last time until which it was below the wanted accuracy
  (good-error 0d0)                  ; the largest until then
  (alone nil)                       ; whether a second one, with the opposite noise, was spared
  (rises '()))                      ; pairs of a time and the difference there, ten times the one before; the last first

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (t t double-float double-float) t) note-difference))

(defparameter *few-steps* 40 "So many or fewer are compared between their ends, too.")
(defparameter *compared-steps* 50 "In so many parts of the way, at least, if steps are so many, something is compared.
More of them do not raise the estimates of twenty systems at five accuracies; half of them lowers some by half.")
(defparameter *compared-pieces* 1000 "The same where each piece between kinks has errors of its own within.")
(defparameter *most-skipped* 8 "So many steps make such a part at most.")
(defparameter *longer* 1.1d0 "A step that is so much longer than all before is compared within.")
(defparameter *much-longer* 1.5d0 "And one that is so much longer than the one before.")
(defparameter *compared-checkpoints* 16 "Where states are not kept, one of so many checkpoints is compared.")

(defun compared (fine coarse weights accuracy)
  "The difference of two integrations, where steps of the coarser one end: they are anywhere in steps of the finer one,
so its values there are compared, too.  Such a value costs more than a step, so of many steps most are skipped; if they
are few, and agree, one looks more often; and always, where states within steps are not as good as their ends, in those
that are longer than all before, or much longer than the one before: where a state has died out, the steps grow beyond
the range of the formula, and their ends alone are good.  Where FINE itself has values that are no numbers, nothing is
known of it."
  (handler-case (difference-found fine coarse weights accuracy)
    ((or domain-violation arithmetic-error) ()
      (make-difference :error 1d0 :good-until (integration-start fine)
                       :parts (copy-seq (the double-array (integration-largest fine)))))))

(defun difference-found (fine coarse weights accuracy)
  "The same, where there are values."
  (let* ((count (step-count fine)) (few (<= count *few-steps*))
         (stride (max 1 (min *most-skipped*
                             (floor count (if (bounded-by-kinks-p fine) *compared-pieces* *compared-steps*)))))
         (difference (unless (and few (ends-agree-p fine coarse weights accuracy))
                       (compared-sometimes fine coarse weights accuracy stride))))
    (note-grazes-of fine coarse weights accuracy
                    (if (and few (or (null difference) (<= (difference-error difference) accuracy)))
                        (compared-often fine coarse weights accuracy)
                        difference))))

(defun note-grazes-of (fine coarse weights accuracy difference)
  "DIFFERENCE, with what surfaces that FINE has grazed leave in doubt from there on."
  (let* ((n (length (integration-final fine))) (state (zeros n)) (other (zeros n))
         (earlier (if (>= (integration-time fine) (integration-start fine)) #'<= #'>=))
         (units (and (integration-grazes fine)
                     (map-doubles ((least (weights-least weights)) (size (integration-largest fine)))
                                  (max least size)))))
    (dolist (graze (integration-grazes fine) difference)
      (let* ((time (graze-time graze))
             (doubts (and (funcall earlier time (integration-time coarse))
                          (funcall earlier time (integration-time fine))
                          (doubts-there graze fine coarse state other)))
             (parts (difference-parts difference)) (worst 0d0))
        (when doubts
          (dotimes (i n)
            (setf (aref parts i) (max (aref parts i) (aref doubts i))
                  worst (max worst (/ (aref doubts i) (max (aref units i) +least-size+)))))
          (setf (difference-error difference) (max worst (difference-error difference)))
          (cond ((<= worst accuracy)
                 (setf (difference-good-error difference) (max worst (difference-good-error difference))))
                ((funcall earlier time (difference-good-until difference))
                 (setf (difference-good-until difference) time))))))))

(defun doubts-there (graze fine coarse state other)
  "What GRAZE leaves in doubt; nil where one of the integrations has no value then."
  (handler-case (progn (dense-value fine (graze-time graze) state)
                       (dense-value coarse (graze-time graze) other)
                       (doubts-of-graze graze state other))
    ((or domain-violation arithmetic-error) () nil)))

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
(defparameter *places-within-pieces* '(0.25d0 0.75d0)
  "The same where pieces between kinks are few steps: there a step of collocation, of 1/0.6 of the length or of as
much, is not at its nodes, where it is best.")
(defparameter *places-within-long* '(0.5d0 0.75d0) "Where in one that is longer than those around.")

(defun times-in-step (integration place parts)
  (mapcar (lambda (part) (+ (aref (the double-array (integration-times integration)) place)
                            (* part (step-length integration place))))
          parts))

(defun compare-at (times coarse out compare)
  "Call COMPARE with each of TIMES at which COARSE has a value, which then is in OUT; it has none where a step that is
taken again for it sees times that are rounded otherwise, at the end perhaps beyond what a function is defined for."
  (declare (type function compare))
  (loop while times
        do (handler-case                                   ; around all, as it takes some Lisps long to make one
               (loop (let ((time (if times (pop times) (return))))
                       (dense-value coarse time out)
                       (funcall compare time)))
             ((or domain-violation arithmetic-error) () nil))))

(defun compared-often (fine coarse weights accuracy)
  "The same at the end of every step, and within, and, where these may be worse, in the middle of those of the finer
one; doubled where the checking integration has taken shorter steps, so that it tells but the error itself."
  (let* ((n (length (integration-final fine)))
         (comparison (make-difference :good-until (integration-start fine) :parts (zeros n)))
         (state (zeros n)) (other (zeros n))
         (compare (comparing fine weights accuracy state other comparison
                             (if (few-steps-p fine) 2d0 1d0))))
    (declare (type function compare))
    (compare-at (times-to-compare fine coarse) coarse other compare)
    (compare-events comparison fine coarse weights accuracy)
    comparison))

(defun times-to-compare (fine coarse)
  "In their order, as far as both go."
  (let* ((even (and (both-even-p fine coarse) (not (few-steps-p fine))))
         (parts (cond ((bounded-by-kinks-p fine) *places-within-pieces*)
                      (even '(0.5d0))
                      (t *places-within*)))
         (direction (if (>= (integration-time fine) (integration-start fine)) 1d0 -1d0))
         (end (* direction (min (* direction (integration-time fine)) (* direction (integration-time coarse))))))
    (merged-times (times-within coarse (append parts '(1d0))) (times-within fine (if even '() '(0.5d0)))
                  direction end)))

(defun both-even-p (fine coarse) (and (integration-even fine) (integration-even coarse)))

(defun times-within (integration parts)
  "An array of the times after PARTS of each step, in their order."
  (let* ((times (integration-times integration)) (count (step-count integration)) (place 0)
         (found (zeros (* count (length parts)))))
    (declare (type (simple-array double-float (*)) times found) (fixnum count place))
    (with-fast-arithmetic
      (for (step count)
        (let* ((begin (aref times step)) (end (aref times (fix (+ step 1)))) (length (flo (- end begin))))
          (declare (double-float begin end length))
          (dolist (each parts)
            (let ((part each))
              (declare (double-float part))
              (setf (aref found place) (if (= part 1d0) end (flo (+ begin (* length part))))
                    place (fix (+ place 1)))))))
      found)))

(defun merged-times (some others direction end)
  "A list of both, which are in their order, as far as END."
  (declare (type (simple-array double-float (*)) some others) (double-float direction end))
  (let ((found '()) (i 0) (j 0) (last (* direction end)))
    (declare (fixnum i j) (double-float last))
    (with-fast-arithmetic
      (loop
        (let* ((one (if (< i (length some)) (flo (* direction (aref some i))) 1d308))
               (other (if (< j (length others)) (flo (* direction (aref others j))) 1d308))
               (first (flo (min one other))))
          (declare (double-float one other first))
          (when (or (> first last) (and (>= i (length some)) (>= j (length others)))) (return))
          (if (<= one other) (setq i (fix (+ i 1))) (setq j (fix (+ j 1))))
          (push (flo (* direction first)) found)))
      (nreverse found))))

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

(defun bounded-by-kinks-p (fine)
  "Whether steps end where kinks are, in both alike, and what is read within may be worse than the ends."
  (and (integration-implicit fine) (integration-sides fine)))

(defun places-of-longest-steps (integration count)
  "Of COUNT of them, ascending: pieces between kinks may be of any lengths."
  (let* ((steps (step-count integration)) (places (make-array steps)))
    (dotimes (place steps) (setf (svref places place) place))
    (sort (coerce (subseq (sort places #'> :key (lambda (place) (abs (step-length integration place))))
                          0 (min count steps))
                  'list)
          #'<)))

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
         (even (both-even-p fine coarse))
         (long (if even '() (times-in-long-steps fine coarse)))
         (kinks (bounded-by-kinks-p fine))
         (long-pieces (if kinks (places-of-longest-steps coarse *most-compared-within*) '()))
         (bounded (or kinks (bounded-by-stability-p fine coarse)))
         (longest 0d0) (previous 0d0))
    (declare (type (simple-array double-float (*)) times state other) (type function compare)
             (double-float end longest previous))
    (labels ((beyond (time)
               (declare (double-float time))
               (if forward (> time end) (< time end)))
             (long-before (time)
               (loop while (and long (if forward (<= (first long) time) (>= (first long) time)))
                     collect (pop long)))
             (compare-within (place all)
               (let ((found (long-before (aref times (1+ place))))
                     (others (and all (times-in-step coarse place (if kinks *places-within-pieces* *places-within*)))))
                 (when (or found others)
                   (compare-at (remove-if #'beyond (merge 'list found others (if forward #'< #'>)))
                               coarse other compare)))))
      (loop for last = 0 then place
            for place = (next-compared coarse last stride)
            while (> place last)
            do (for (step place last)
                 (let ((length (flo (abs (- (aref times (fix (+ step 1))) (aref times step))))))
                   (declare (double-float length))
                   (compare-within step
                                   (or (and bounded (= step last))
                                       (when (eql step (first long-pieces)) (pop long-pieces) t)
                                       (and (not even)
                                            (> step (the fixnum *few-steps*))       ; the first ones only grow
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
to the end of the step that it is in: what grows from 0 is not asked for digits of what it is within a step; and if the
field changes there, of the next one: a time is rounded, and what is hit there moves in it."
  (declare (double-float factor))
  (let* ((largest (copy-seq (weights-least weights)))
         (grains (weights-grains weights))
         (times (integration-times fine))
         (states (integration-states fine))
         (kept (states-kept fine))
         (differences (difference-parts comparison))
         (beginnings (coerce (integration-beginnings fine) 'list))
         (forward (>= (integration-time fine) (integration-start fine)))
         (seen 0) (place 0))
    (declare (fixnum seen place kept))
    (lambda (time)
      (declare (double-float time))
      (loop until (or (null grains)
                      (let ((next (caar grains)))
                        (declare (double-float next))
                        (if forward (> next time) (< next time))))
            do (raise-sizes largest (cdr (pop grains)) 0 1 (/ *noise* accuracy)))
      (setq place (step-place-from times place time))
      (when states
        (loop while (and beginnings (<= (the fixnum (first beginnings)) place)) do (pop beginnings))
        (let ((end (min (+ place (if (eql (first beginnings) (1+ place)) 3 2)) kept)))
          (declare (fixnum end))
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
  (declare (double-float difference accuracy))
  (when (> difference (the double-float (difference-error comparison)))
    (setf (difference-error comparison) difference)
    (when (> difference (* 10 (or (cdr (first (difference-rises comparison))) 1d-18)))
      (push (cons time difference) (difference-rises comparison))))
  (unless (> (the double-float (difference-error comparison)) accuracy)
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
