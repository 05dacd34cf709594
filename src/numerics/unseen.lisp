;;; anmech: what acts for a shorter time than steps take, and so may have been stepped over.
;;;
;;; Two integrations agree if both step over a pulse.  Where the field depends on time, it is looked at in long steps,
;;; at equidistant times and one and the same state: where its fourth differences are no small ones, or all at once much
;;; larger than before, the motion that was found is put into the equations; where the rates are others than those of
;;; the motion, something was not seen, and it is integrated again with steps that end there.  What was not seen counts
;;; in units of the sizes that the states have had until then, as errors do: those of a motion that grows are larger
;;; later; it may be a third of the error that is told, as errors may grow afterwards.  Of stiff equations small errors
;;; make large rates, which decay at once.  A pulse between two of these times is not found: who knows of one says so by
;;; breakpoints or the longest step.
;;;
;;; Entry points: UNSEEN-TIMES, *LOOKS-FOR-PULSES*.
;;;
;;; Literature: W. H. Enright, A new error-control for initial value solvers, Appl. Math. Comput. 31 (1989) 288 (the
;;; defect).

(in-package :anmech)
(needs "arithmetic/floats" "numerics/integration" "numerics/weights")

(defparameter *looks-for-pulses* 2000 "At how many times, if all steps are long.")
(defparameter *most-unseen* 200 "How many times are handed out.")

(defun unseen-times (problem integration error)
  "Times, in the order of the motion, at which INTEGRATION, which is said to err by ERROR, does not follow the
equations, and their neighbours."
  (let* ((start (integration-start integration)) (end (integration-time integration))
         (spacing (/ (- (problem-end problem) start) *looks-for-pulses*)) (found '()) (sizes nil)
         (state (zeros (problem-n problem))))
    (unless (= start end)
      (setq sizes (least-along problem integration nil))
      (dotimes (place (step-count integration))
        (raise-sizes sizes (state-of-step integration place state) 0 1 1d0)
        ;; a shorter step has looked as closely itself
        (when (> (abs (step-length integration place)) (* 5 (abs spacing)))
          (dolist (time (times-of-defects problem integration place spacing sizes (/ (max error 3d-11) 3)))
            (loop with k = (round (- time start) spacing)
                  for near from (1- k) to (1+ k)
                  do (pushnew (+ start (* near spacing)) found))            ; that of two neighbours is the same double
            (when (> (length found) *most-unseen*) (return-from unseen-times (nreverse found)))))))
    (nreverse found)))

(defun times-of-defects (problem integration place spacing sizes least)
  "Times in the step at PLACE at which the rates of the motion, whose states have had SIZES, are not those of the field,
if that has changed one of the states by more than the part LEAST of its size: what lasts for longer than SPACING adds
up.  Those where the defect is a small one beside others are not among them."
  (let* ((sum (zeros (problem-n problem))) (counts nil) (largest 0d0) (found '()))
    (declare (type double-array sum) (double-float largest))
    (dolist (time (rough-times problem integration place spacing))
      (let ((defects (defects-at problem integration place time spacing)) (part 0d0))
        (declare (double-float part))
        (when defects
          (dotimes (i (length sum))
            (let ((defect (* spacing (the double-float (aref (the double-array defects) i))))
                  (size (aref (the double-array sizes) i)))
              (declare (double-float defect size))
              (incf (aref sum i) defect)
              (when (> (abs (aref sum i)) (* least size)) (setq counts t))
              (setq part (max part (/ (abs defect) (max size least-positive-normalized-double-float))))))
          (setq largest (max largest part))
          (push (cons time part) found))))
    (when counts
      (loop for (time . part) in (nreverse found)
            when (> (the double-float part) (* 1d-1 largest)) collect time))))

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
  "The numbers from 0 below COUNT of the times, from TIME on, about which FIELD is rough: its fourth differences are no
small ones beside the second, or all at once much larger than they have been, for a pulse may be small beside the rates
and their changes, and rounding is smaller still."
  (declare (type function field) (type (simple-array double-float (*)) point) (double-float time spacing)
           (fixnum n count))
  (let ((a (zeros n)) (b (zeros n)) (c (zeros n)) (d (zeros n)) (e (zeros n)) (found '())
        (largest (zeros n))
        (recent (zeros n)) (before (vast n)) (calm (vast n)))     ; the largest fourth differences until some times ago
    (declare (type (simple-array double-float (*)) a b c d e recent before calm largest))
    (with-fast-arithmetic
      (setf (aref point n) time)
      (for (k count)
        (rotatef a b c d e)
        (funcall field point e)
        (setf (aref point n) (flo (+ (aref point n) spacing)))
        (when (and (>= k 8) (zerop (logand k 3)))
          (replace calm before)
          (replace before recent))
        (let ((rough nil))
          (for (i n)
            (setf (aref largest i) (flo (max (aref largest i) (abs (aref e i)))))
            (let* ((first (flo (- (+ (aref a i) (aref c i)) (* 2d0 (aref b i)))))
                   (second (flo (- (+ (aref b i) (aref d i)) (* 2d0 (aref c i)))))
                   (third (flo (- (+ (aref c i) (aref e i)) (* 2d0 (aref d i)))))
                   (fourth-difference (flo (abs (- (+ first third) (* 2d0 second))))))
              (declare (double-float first second third fourth-difference))
              (when (and (> fourth-difference (flo (* 1d-11 (aref largest i))))
                         (or (> fourth-difference
                                (flo (* 0.25d0 (max (abs first) (max (abs second) (abs third))))))
                             (> fourth-difference (flo (* 30d0 (aref calm i))))))
                (setq rough t))
              (when (>= k 4) (setf (aref recent i) (flo (max (aref recent i) fourth-difference))))))
          (when (and rough (>= k 4))
            (loop for back of-type fixnum from 0 to 4 do (pushnew (fix (- k back)) found))))))
    (sort found #'<)))

(defun vast (n) (make-array n :element-type 'double-float :initial-element 1d300))

(defun defects-at (problem integration place time spacing)
  "By what the rates of the field differ at TIME from those of the motion, in the step at PLACE; nil where one of them
has no value, or next to the ends of the step."
  (declare (double-float time))
  (let* ((n (problem-n problem)) (kept (kept-of-step integration place)) (point (copy-seq (problem-start problem)))
         (before (zeros n)) (after (zeros n)) (rates (zeros n)) (value (integration-interpolant integration))
         (begin (aref (the double-array (integration-times integration)) place))
         (length (step-length integration place))
         (width (* 1d-4 (abs length))))
    (declare (type double-array point) (type function value) (double-float begin length width))
    (when (and (< width (abs (- time begin))) (< width (abs (- (+ begin length) time))))
      (funcall value kept (- time width) before n)
      (funcall value kept (+ time width) after n)
      (funcall value kept time point n)
      (setf (aref point n) time)
      (handler-case
          (progn (funcall (the function (problem-field problem)) point rates)
                 (held-back
                  problem point rates spacing
                  (map-doubles ((rate rates) (earlier before) (later after))
                    (flo (- rate (/ (- later earlier) (* 2d0 width)))))))
        ((or domain-violation arithmetic-error) () nil)))))

(defun held-back (problem point rates spacing defects)
  "What DEFECTS of the RATES at POINT come to for as long as SPACING, if the rates that they change themselves hold them
back: of stiff equations small errors of states make large rates."
  (let* ((n (problem-n problem)) (other (copy-seq point)) (changed (zeros n)) (spacing (abs spacing))
         (part 1d-1))
    (declare (type double-array other) (double-float spacing part))
    (dotimes (i n)
      (incf (aref other i) (* part spacing (the double-float (aref (the double-array defects) i)))))
    (funcall (the function (problem-field problem)) other changed)
    (map-doubles ((defect defects) (rate rates) (new changed))
      (flo (/ defect (+ 1d0 (/ (abs (- new rate)) (* part (max (abs defect) 1d-200)))))))))
