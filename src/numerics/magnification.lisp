;;; anmech: how much larger the errors of functions of states are than those of the states themselves, along a motion.
;;;
;;; A state z with an error of a part e of its largest size so far makes an error of |dW/dz| |z| e of W: these, added up
;;; and relative to the largest size that W has had; or to the largest that it will have, if it begins at 0, where an
;;; error of z has not grown yet.  The motion is read between its steps, which are short where much happens.
;;;
;;; Entry points: $anmech_magnification.

(in-package :anmech)
(needs "numerics/drawn_curves" "numerics/motion" "numerics/motion_reading")

(defconstant +least-part+ 1d-6 "What begins at a smaller part of its largest size is measured by that.")

(maxima::defmfun maxima::$anmech_magnification (motion reader functions states)
  "anmech_magnification(record, reader, n, m): the reader reads n functions W, m states z, the partial derivatives of
each W by the states, and coefficients that should not vanish.  The largest of sum |dW/dz| |z| relative to W, at least
1; false, where a coefficient changes its sign or something has no value."
  (let* ((rows (points-at motion reader (watching-times motion)))
         (watched (+ functions states (* functions states)))
         (signs (mapcar #'signum (nthcdr watched (first rows)))))
    (cond ((some (lambda (row) (or (null row) (find 0d0 signs)
                                   (notevery (lambda (sign value) (plusp (* sign value))) signs (nthcdr watched row))))
                 rows)
           nil)
          ((zerop functions) 1)
          (t (magnification (mapcar (lambda (row) (coerce (subseq row 0 watched) 'vector)) rows) functions states)))))

(defun watching-times (motion)
  (if (motion-long motion)
      (rest (maxima::$anmech_sample_times motion 401))
      (drawing-times motion 101 1000)))

(defun magnification (rows functions states)
  (let ((largest (reduce (lambda (sizes row) (map 'vector #'max sizes (map 'vector #'abs (subseq row 0 functions))))
                         rows :initial-value (make-array functions :initial-element 0d0)))
        (sizes (make-array (+ functions states) :initial-element 0d0))
        (most 1d0))
    (dolist (row rows most)
      (dotimes (place (length sizes))
        (setf (aref sizes place) (max (aref sizes place) (abs (aref row place)))))
      (dotimes (place functions)
        (let ((size (if (<= (abs (aref (first rows) place)) (* +least-part+ (aref largest place)))
                        (aref largest place)
                        (aref sizes place)))
              (errors (loop for state below states
                            sum (* (abs (aref row (+ functions states (* place states) state)))
                                   (aref sizes (+ functions state))))))
          (when (plusp size) (setq most (max most (/ errors size)))))))))
