;;; Real numbers of Maxima, and the doubles next to them.
;;;
;;; Entry points: exact-value, neighbour, doubles, two-digits, short-text; $anmech_double.

(in-package :anmech)
(needs "session/scope" "session/texts" "numerics/dag")

(defun exact-value (form)
  "The rational value of a real number of Maxima, of an irrational one to 40 digits; nil if FORM is no finite number."
  (flet ((rational-of (form)
           (cond ((rationalp form) form)
                 ((floatp form) (to-rational form form))
                 ((operator-p form 'maxima::rat) (/ (second form) (third form)))
                 ((operator-p form 'maxima::bigfloat) (bigfloat-value form)))))
    (handler-case (or (rational-of form)
                      (rational-of (maxima::meval `((maxima::mprog)
                                                    ((maxima::mlist) ((maxima::msetq) maxima::$fpprec 40))
                                                    ((maxima::$bfloat) ((maxima::mquote) ,form))))))
      (unsupported-expression () nil))))

(defun neighbour (number exact)
  "The double next to NUMBER on the side of EXACT; NUMBER itself where it is exact."
  (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
    (let ((difference (- exact (* sign mantissa (expt 2 exponent)))))
      (if (or (zerop difference) (zerop number))
          number
          (to-double (* (+ (* sign mantissa) (signum difference)) (expt 2 exponent)))))))

(defun doubles (numbers)
  (let ((array (make-array (length numbers) :element-type 'double-float)) (place -1))
    (dolist (number numbers array)
      (setf (aref array (incf place)) number))))

(defun decimal-unit (number)
  "A power of ten: the second significant decimal of the positive NUMBER is a multiple of it."
  (expt 10 (1- (floor (log number 10)))))

(defun two-digits (number)
  "NUMBER rounded up to two significant decimals, or a neighbour of that which Maxima shows with fewer digits."
  (if (zerop number)
      number
      (let ((unit (decimal-unit number)))
        (shortest-near (* unit (ceiling (exact-value number) unit))))))

(defvar *shortest* (make-hash-table :test #'eql) "What SHORTEST-NEAR has found: to make texts takes long.")

(defun shortest-near (number)
  "A double next to the rational NUMBER, of two decimals, which Maxima shows with few digits."
  (or (gethash number *shortest*)
      (let ((nearest (to-double number)))
        (setf (gethash number *shortest*)
              (first (sort (list nearest (neighbour nearest (* 2 number)) (neighbour nearest 0))
                           #'< :key (lambda (number) (length (maxima-text number)))))))))

(defun short-text (number)
  "The positive NUMBER with two digits, for a message."
  (let ((unit (decimal-unit number)))
    (format nil "~,1fe~d" (float (/ (round (exact-value number) unit) 10) 1f0) (1+ (round (log unit 10))))))

(maxima::defmfun maxima::$anmech_double (form)
  "anmech_double(number): the double next to it; false if it is no finite real number."
  (let ((value (exact-value form)))
    (and value (handler-case (to-double value) (unsupported-expression () nil)))))
