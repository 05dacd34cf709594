;;; What rtest_radau.mac asks of the derivatives of fields.

(in-package :anmech)

(mapc #'load-kernel '("numerics/differentiation" "numerics/motion"))

(maxima::defmfun maxima::$derivatives_off (motion numbers)
  "derivatives_off(m, [state, .., time, parameter, ..]): how far those of the program are from differences of the field,
in units of the largest of them."
  (let* ((model (motion-model (first (last motion)))) (n (model-dimension model))
         (in (replace (zeros (length (model-inputs model))) (exact-doubles (rest numbers))))
         (matrix (zeros (* n n))) (above (zeros n)) (below (zeros n)) (worst 0d0) (h 1d-5))
    (funcall (field-derivatives model) in matrix)
    (dotimes (j n)
      (let ((kept (aref in j)))
        (flet ((rates-at (step out) (setf (aref in j) (+ kept step)) (funcall (model-smooth-field model) in out)))
          (rates-at h above)
          (rates-at (- h) below)
          (setf (aref in j) kept))
        (dotimes (i n)
          (setq worst (max worst (abs (- (aref matrix (+ j (* i n)))
                                         (/ (- (aref above i) (aref below i)) (* 2 h)))))))))
    (/ worst (reduce #'max matrix :key #'abs))))
