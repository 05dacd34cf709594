;;; anmech: what acts for a shorter time than steps take, and so may have been stepped over.
;;;
;;; Two integrations agree if both step over a pulse.  Where the field depends on time, it is looked at in long steps,
;;; at equidistant times and one and the same state: where its fourth differences are no small ones, the motion that was
;;; found is put into the equations; where the rates are others than those of the motion, something was not seen, and it
;;; is integrated again with steps that end there.  A pulse between two of these times is not found: who knows of one
;;; says so by breakpoints or the longest step.
;;;
;;; Entry points: UNSEEN-TIMES, *LOOKS-FOR-PULSES*.
;;;
;;; Literature: W. H. Enright, A new error-control for initial value solvers, Appl. Math. Comput. 31 (1989) 288 (the
;;; defect).

(in-package :anmech)
(needs "arithmetic/floats" "numerics/integration")

(defparameter *looks-for-pulses* 2000 "At how many times, if all steps are long.")
(defparameter *most-unseen* 200 "How many times are handed out.")

(defun unseen-times (problem integration error)
  "Times, in the order of the motion, at which INTEGRATION, which is said to err by ERROR, does not follow the
equations, and their neighbours."
  (let* ((start (integration-start integration)) (end (integration-time integration))
         (spacing (/ (- (problem-end problem) start) *looks-for-pulses*)) (found '()))
    (unless (= start end)
      (dotimes (place (step-count integration))
        ;; a shorter step has looked as closely itself
        (when (> (abs (step-length integration place)) (* 5 (abs spacing)))
          (dolist (time (rough-times problem integration place spacing))
            (when (defect-p problem integration place time spacing error)
              (loop with k = (round (- time start) spacing)
                    for near from (1- k) to (1+ k)
                    do (pushnew (+ start (* near spacing)) found)))         ; that of two neighbours is the same double
            (when (> (length found) *most-unseen*) (return-from unseen-times (nreverse found)))))))
    (nreverse found)))

(defun rough-times (problem integration place spacing)
  "Of the multiples of SPACING in the step at PLACE, those about which the field is rough as a function of time alone."
  (let* ((start (integration-start integration)) (length (step-length integration place))
         (way (- (aref (the double-array (integration-times integration)) place) start))
         (point (copy-seq (problem-start problem))))
    (state-of-step integration place point)
    (let ((first (ceiling way spacing)))
      (mapcar (lambda (k) (+ start (* (+ first k) spacing)))
              (rough-places (field-where-it-is (problem-field problem)) point (problem-n problem)
                            (+ start (* first spacing)) spacing (1+ (- (floor (+ way length) spacing) first)))))))

(defun field-where-it-is (field)
  "FIELD, with 0 for rates that have no value, or one that is too large for a double: elsewhere a pulse is still seen."
  (declare (type function field))
  (lambda (point rates)
    (handler-case (funcall field point rates)
      ((or domain-violation arithmetic-error) () (fill (the double-array rates) 0d0)))))

(defun rough-places (field point n time spacing count)
  "The numbers from 0 below COUNT of the times, from TIME on, about which FIELD is rough."
  (declare (type function field) (type (simple-array double-float (*)) point) (double-float time spacing)
           (fixnum n count))
  (let ((a (zeros n)) (b (zeros n)) (c (zeros n)) (d (zeros n)) (e (zeros n)) (largest (zeros n)) (found '()))
    (declare (type (simple-array double-float (*)) a b c d e largest))
    (with-fast-arithmetic
      (setf (aref point n) time)
      (for (k count)
        (rotatef a b c d e)
        (funcall field point e)
        (setf (aref point n) (flo (+ (aref point n) spacing)))
        (let ((rough nil))
          (for (i n)
            (setf (aref largest i) (flo (max (aref largest i) (abs (aref e i)))))
            (when (> (flo (abs (+ (aref a i) (* -4d0 (aref b i)) (* 6d0 (aref c i)) (* -4d0 (aref d i)) (aref e i))))
                     (flo (* 1d-3 (aref largest i))))
              (setq rough t)))
          (when (and rough (>= k 4))
            (loop for back of-type fixnum from 0 to 4 do (pushnew (fix (- k back)) found))))))
    (sort found #'<)))

(defun defect-p (problem integration place time spacing error)
  "Whether at TIME, in the step at PLACE, the rates of the motion are not those of the field."
  (let* ((n (problem-n problem)) (kept (kept-of-step integration place)) (point (copy-seq (problem-start problem)))
         (before (zeros n)) (after (zeros n)) (rates (zeros n)) (value (integration-interpolant integration))
         (begin (aref (the double-array (integration-times integration)) place))
         (length (step-length integration place))
         (width (* 1d-4 (abs length))))
    (declare (type double-array point) (type function value))
    (when (and (< width (abs (- time begin))) (< width (abs (- (+ begin length) time))))
      (funcall value kept (- time width) before n)
      (funcall value kept (+ time width) after n)
      (funcall value kept time point n)
      (setf (aref point n) time)
      (handler-case (progn (funcall (the function (problem-field problem)) point rates)
                           (defect-counts-p before after rates (* 2 width) (abs spacing)
                                            (integration-largest integration) (* 3 (max error 1d-11))))
        ((or domain-violation arithmetic-error) () nil)))))

(defun defect-counts-p (before after rates width spacing sizes least)
  "Whether the rates of one of the states, which goes from BEFORE to AFTER in the time WIDTH, would change it by more
than the part LEAST of its size within SPACING."
  (declare (type double-array before after rates) (double-float width spacing least))
  (dotimes (i (length rates) nil)
    (let ((defect (abs (- (aref rates i) (/ (- (aref after i) (aref before i)) width)))))
      (declare (double-float defect))
      (when (> (* spacing defect) (* least (the double-float (aref (the double-array sizes) i)))) (return t)))))
