;;; anmech: integration to a wanted accuracy of the result.
;;;
;;; A method of integration bounds the error of one step; what a user asks for is an error of the whole. So a motion is
;;; integrated twice, the second time with a tolerance ten times coarser, and both are compared at every step; if they
;;; differ by more than was asked for, both are done again with a finer tolerance.  The difference is the error of the
;;; coarser motion, and the finer one is handed out: the estimate is on the safe side.  Besides, the coarser one starts
;;; from the other neighbouring doubles wherever a given number had to be rounded, and its field sees every state
;;; changed by one unit in the last place: so the estimate also holds what rounding does in the end.
;;;
;;; All that this asks of a method is a function (problem tolerance progress) that gives an integration; of one that
;;; goes step by step, its formula (integration.lisp).
;;;
;;; Entry points: ACCURATE-MOTION, MOTION-BY-FORMULA.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4;
;;; L. F. Shampine, Tolerance proportionality in ODE codes, Lecture Notes in Mathematics 1386 (1989) 118-136.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/doubles" "numerics/integration" "numerics/motion" "numerics/progress"
       "numerics/weights")

;;; Two integrations and their difference

(defstruct difference
  (error 0d0)                       ; the largest difference of a state, in units of its largest size so far
  good-until                        ; the last time until which it was below the wanted accuracy
  (good-error 0d0))                 ; the largest until then

(defun compared (fine coarse weights accuracy)
  "The difference of two integrations with dense output, where the steps of the coarser one end and twice in between."
  (let* ((n (length (integration-final fine)))
         (comparison (make-difference :good-until (integration-start fine)))
         (state (zeros n))
         (other (zeros n))
         (largest (copy-seq (weights-least weights)))
         (grains (weights-grains weights))
         (end (integration-time fine))
         (forward (>= end (integration-start fine))))
    (labels ((later-p (time other) (if forward (> time other) (< time other)))
             (compare (time)
               (loop until (or (null grains) (later-p (car (first grains)) time))
                     do (map-into largest (lambda (size grain) (max size (/ (* *noise* grain) accuracy)))
                                  largest (cdr (pop grains))))
               (dense-value fine time state)
               (dense-value coarse time other)
               (note-difference comparison time (largest-difference state other largest) accuracy)))
      (loop for (start . more) on (coerce (integration-times coarse) 'list)
            while (and more (not (later-p (first more) end)))
            do (dolist (part '(1 2 3))
                 (compare (if (= part 3) (first more) (+ start (* (/ part 3d0) (- (first more) start))))))))
    comparison))

(defun note-difference (comparison time difference accuracy)
  (setf (difference-error comparison) (max difference (difference-error comparison)))
  (unless (> (difference-error comparison) accuracy)
    (setf (difference-good-until comparison) time
          (difference-good-error comparison) (difference-error comparison))))

(defun joined-differences (first second)
  (make-difference :error (max (difference-error first) (difference-error second))
                   :good-until (if (< (difference-good-error first) (difference-good-error second))
                                   (difference-good-until first)
                                   (difference-good-until second))
                   :good-error (max (difference-good-error first) (difference-good-error second))))

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
  "FIELD, whose input has SIZE numbers, with the states multiplied by FACTORS."
  (declare (type function field) (type (simple-array double-float (*)) factors))
  (let ((n (length factors)) (seen (zeros size)))
    (declare (type (simple-array double-float (*)) seen) (fixnum n))
    (lambda (in out)
      (declare (type (simple-array double-float (*)) in out))
      (with-fast-arithmetic
        (for (i n) (setf (aref seen i) (flo (* (aref factors i) (aref in i)))))
        (for (i (length seen) n) (setf (aref seen i) (aref in i)))
        (funcall field seen out)
        nil))))

(defun noisy-problem (problem other direction from)
  "PROBLEM with the noise of the direction that leads from its start to OTHER, begun at FROM."
  (let ((factors (noise-factors (problem-start problem) other (problem-n problem) direction)))
    (make-problem :model (problem-model problem)
                  :field (noisy-field (problem-field problem) factors (length from))
                  :start from
                  :n (problem-n problem)
                  :end (problem-end problem)
                  :noise factors)))

;;; Passes

(defparameter *most-doubles* 10000000 "How many are kept of an integration at most: 80 megabytes.")
(defparameter *finest* 5d-16 "The finest tolerance that makes sense.")
(defparameter *fine* 1d-14 "A tolerance from which on rounding matters.")

(defun coarser (tolerance)
  "The tolerance of the second integration; near the finest possible, less is left between both."
  (* tolerance (if (<= tolerance *finest*) 4d0 10d0)))

(defun motion-of-pass (task method tolerance weights progress)
  "Integrate with TOLERANCE and, to verify, with a coarser one: a motion, what was seen in comparing, better weights."
  (let* ((problem (task-problem task)) (start (problem-start problem)) (verify (task-verify task))
         (fine (funcall method problem (growing-tolerance weights tolerance problem) (telling progress "")))
         (weights (if verify (measured-weights problem fine) weights))
         (motion (make-motion :model (problem-model problem) :integration fine :start start
                              :reached (integration-time fine) :evaluations (integration-evaluations fine))))
    (flet ((comparison (from tolerance direction)
             (let* ((noisy (noisy-problem problem (task-other-start task) direction from))
                    (coarse (funcall method noisy (growing-tolerance weights tolerance noisy)
                                     (telling progress "check of "))))
               (incf (motion-evaluations motion) (integration-evaluations coarse))
               (compared fine coarse weights (task-accuracy task)))))
      (let ((comparison (if verify
                            (comparison (task-other-start task) (coarser tolerance) 1)
                            (make-difference :good-until (integration-time fine)))))
        ;; near the limit the difference is one of chance: two are better than one
        (when (and verify (<= tolerance *fine*))
          (setq comparison (joined-differences comparison (comparison start (* 1.5d0 tolerance) -1))))
        (values motion comparison weights)))))

(defun rounding-limited-p (error tolerance previous-error previous-tolerance)
  "Whether the error has not fallen as the tolerance has: then rounding governs it."
  (and previous-error
       (<= tolerance *fine*)
       (> error (* 2 previous-error (/ (coarser tolerance) (coarser previous-tolerance))))))

(defun next-tolerance (tolerance ratio)
  "A finer tolerance, where RATIO is the wanted error by that which was found; short of the finest, a stop is made."
  (max (if (> tolerance (* 2 *fine*)) *fine* *finest*)
       (* tolerance (max 1d-4 (min 0.1d0 (* 0.4d0 ratio))))))

(defun motion-trouble (motion)
  "The sentence that says why it ends early, or nil."
  (integration-message (motion-integration motion)))

(defun out-of-steps-p (motion)
  (eq :too-many-steps (integration-status (motion-integration motion))))

(defun better-p (motion error best least)
  "Whether a later motion is to be preferred.  One that meets with an obstacle is, since it looks closer than those
before."
  (cond ((null best) t)
        ((out-of-steps-p motion) nil)
        ((or (motion-trouble motion) (motion-trouble best)) t)
        (t (< error least))))

(defun last-pass-p (motion error accuracy tolerance previous-error)
  (cond ((or (<= tolerance *finest*) (out-of-steps-p motion)) t)
        ((motion-trouble motion) (<= tolerance *fine*))
        (t (or (<= error accuracy)
               (and previous-error (<= tolerance *fine*) (< (* 0.5d0 previous-error) error))))))

(defun accurate-motion (task method)
  "The motion of TASK by METHOD, a function as above."
  (let* ((accuracy (task-accuracy task)) (verify (task-verify task)) (progress (task-progress task))
         (weights (first-weights (task-problem task)))
         (tolerance (if verify (max (/ accuracy 10) 1d-6) (/ accuracy 10)))
         (best nil) (least nil) (evaluations 0) (previous-error nil) (previous-tolerance nil))
    (loop for pass from 1
          do (multiple-value-bind (motion comparison better-weights)
                 (motion-of-pass task method tolerance weights (and progress (progress-of-pass progress pass)))
               (let ((error (difference-error comparison)))
                 (when (rounding-limited-p error tolerance previous-error previous-tolerance)
                   (setq error (* 3 error)))
                 (incf evaluations (motion-evaluations motion))
                 (when (better-p motion error best least)
                   (setq best motion least error)
                   (finish-motion motion comparison error accuracy verify))
                 (when (or (not verify) (last-pass-p motion error accuracy tolerance previous-error))
                   (return))
                 (setq weights better-weights
                       previous-error error
                       previous-tolerance tolerance
                       tolerance (next-tolerance tolerance (if (motion-trouble motion) 0d0 (/ accuracy error)))))))
    (setf (motion-error-estimate best) (and verify (two-digits (motion-error-estimate best)))
          (motion-evaluations best) evaluations)
    best))

(defun motion-by-formula (task formula)
  "The motion of TASK by steps of FORMULA."
  (let* ((room (funcall (formula-room formula) (problem-n (task-problem task))))
         (most (or (task-max-steps task) (floor *most-doubles* room))))
    (accurate-motion task (lambda (problem tolerance progress)
                            (integrate-by-steps formula problem tolerance most progress)))))

(defun finish-motion (motion comparison error accuracy verify)
  "Note the estimate of the error, and say what is to be said.  A motion that ends at an obstacle is given as far as it
is accurate: where it ends, it need not be."
  (let ((trouble (motion-trouble motion)) (bad (and verify (> error accuracy))))
    (setf (motion-error-estimate motion) (and verify error))
    (cond ((and trouble verify (or bad (not (out-of-steps-p motion))))
           (setf (motion-reached motion) (difference-good-until comparison)
                 (motion-error-estimate motion) (difference-good-error comparison)
                 (motion-message motion) trouble))
          (trouble (setf (motion-message motion) trouble))
          (bad (setf (motion-message motion) (format nil "the accuracy of ~a was not reached, only ~a"
                                                     (short-text accuracy) (short-text error)))))))
