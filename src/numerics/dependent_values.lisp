;;; anmech: values that are expressions in numbers that each point of many gives, computed point by point.
;;;
;;; In doubles they go through registers.  Where a motion has more digits than doubles have, or bounds that are proved,
;;; the numbers are put in as they are: so the value is as exact as one that is given.
;;;
;;; Entry points: NUMBERS-OF-POINT; anmech_dependent_values.

(in-package :anmech)
(needs "algebra/terms" "arithmetic/floats" "numerics/dag" "numerics/doubles" "numerics/evaluation"
       "numerics/motion_reading" "numerics/registers")

(defstruct (dependent-value (:print-function print-dependent-value))
  place name        ; the place of the value among the numbers of a motion, and how a user types what has it
  expression names  ; of names whose numbers a point gives
  registers)        ; what computes it in doubles

(defun print-dependent-value (value stream depth)
  (declare (ignore value depth))
  (write-string "..." stream))

(maxima::defmfun maxima::$anmech_dependent_values (places texts expressions names)
  "anmech_dependent_values([place, ...], [text, ...], [expr, ...], [name, ...]): what computes the expressions in the
names, which each point gives a number, for these places among the numbers of a motion."
  (maxima-list
   (mapcar (lambda (place text expression)
             (make-dependent-value :place (1- place) :name text :expression expression :names (rest names)
                                   :registers (expressions-registers (list expression) (rest names))))
           (rest places) (rest texts) (rest expressions))))

(defun number-in-doubles (value row)
  "The number that the dependent VALUE has where its names have those of ROW; or what is wrong with it, a sentence."
  (let* ((registers (dependent-value-registers value)) (numbers (registers-numbers registers)) (place 0))
    (declare (type double-array numbers) (fixnum place))
    (dolist (number row)
      (setf (aref numbers place) (the double-float (maxima::$anmech_double number)))
      (incf place))
    (handler-case (progn (run-registers registers)
                         (let ((number (first (result-list registers))))
                           (if (finite-p number) number (trouble-with-size value))))
      (domain-violation () (trouble-with-value value))
      (arithmetic-error () (trouble-with-size value)))))

(defun trouble-with-value (value)
  (format nil "~a has no real value at this point" (dependent-value-name value)))

(defun trouble-with-size (value)
  (format nil "the value of ~a is too large for a double at this point" (dependent-value-name value)))

(defun exact-number (value row)
  "The same without rounding, as a number of Maxima, which may be irrational."
  (let ((numbers (mapcar #'cons (dependent-value-names value) row)))
    (labels ((exact (form) (if (floatp form) (from-rational (rational form)) form))
             (put-in (form)
               (let ((given (assoc form numbers :test #'maxima::alike1)))
                 (cond (given (exact (cdr given)))
                       ((atom form) (exact form))
                       (t (cons (remove 'maxima::simp (car form)) (mapcar #'put-in (rest form))))))))
      (handler-case (let ((number (maxima::simplify (put-in (dependent-value-expression value)))))
                      (if (maxima::$anmech_double number) number (trouble-with-value value)))
        (maxima::maxima-$error () (trouble-with-value value))))))

(defun numbers-of-point (numbers places row values exactly)
  "A copy of NUMBERS with those of ROW in PLACES, and with the dependent VALUES in theirs; or a sentence that says which
of these has no value.  A place below 0 is that of a number of which the values alone make use."
  (let ((all (copy-list numbers)))
    (loop for place in places
          for number in row
          do (unless (minusp place) (setf (nth place all) number)))
    (dolist (value values all)
      (let ((number (if exactly (exact-number value row) (number-in-doubles value row))))
        (when (stringp number) (return number))
        (setf (nth (dependent-value-place value) all) number)))))
