;;; anmech: complex doubles with a bound of their error.
;;;
;;; Entry points: APPROXIMATE, ADD-APPROXIMATE, MULTIPLY-APPROXIMATE, RAISE-APPROXIMATE, CERTAINLY-NONZERO-P, PRECISE-P,
;;; REFUSE-JUMP, REAL-IF-REAL, ALMOST-REAL, UNDECIDED; the constant +UNIT+.
;;;
;;; Source: running error bounds after N. J. Higham, Accuracy and Stability of Numerical Algorithms (2002), section 3.3.

(in-package :anmech)

(defconstant +unit+ 2.3d-16)

(defun undecided ()
  "Leave: rounding does not let the value be told."
  (throw 'undecided :undecided))

;;; A number with its error bound is a pair (value . bound).

(defun approximate (value bound)
  (cons value (+ bound (* +unit+ (abs value)))))

(defun add-approximate (a b)
  (approximate (+ (car a) (car b)) (+ (cdr a) (cdr b))))

(defun multiply-approximate (a b)
  (approximate (* (car a) (car b))
               (+ (* (abs (car a)) (cdr b)) (* (abs (car b)) (cdr a)) (* (cdr a) (cdr b)))))

(defun certainly-nonzero-p (a)
  (> (abs (car a)) (* 100 (cdr a))))

(defun precise-p (a)
  "Whether a value within its bound says anything: where numbers of size 1e12 cancel, what is left is noise."
  (< (cdr a) 1d-4))

(defun raise-approximate (base exponent)
  (cond ((certainly-nonzero-p base)
         (if (integerp exponent) (whole-power base exponent) (general-power base exponent)))
        ((and (integerp exponent) (> exponent 0))        ; the first-order bound is too small here
         (let ((size (abs (car base))))
           (approximate (expt (car base) exponent) (- (expt (+ size (cdr base)) exponent) (expt size exponent)))))
        (t (undecided))))

(defun whole-power (base exponent)
  (let ((value (expt (car base) exponent)))
    (approximate value (* (abs exponent) (abs (/ value (car base))) (+ (cdr base) (* +unit+ (abs (car base))))))))

(defun general-power (base exponent)
  (refuse-jump base)
  (let* ((logarithm (log (real-if-real (car base))))
         (value (exp (* (car exponent) logarithm))))
    (when (zerop value) (undecided))                     ; no power is 0: it is too small for doubles
    (approximate value (* (abs value)
                          (+ (* (abs (car exponent)) (/ (cdr base) (abs (car base))))
                             (* (+ (cdr exponent) (* +unit+ (abs (car exponent)))) (abs logarithm)))))))

(defun refuse-jump (a)
  "A number that only rounding keeps off the real axis, where functions jump, decides nothing."
  (when (and (complexp (car a)) (/= 0 (imagpart (car a))) (<= (abs (imagpart (car a))) (* 100 (cdr a))))
    (undecided)))

(defun real-if-real (z)
  (if (and (complexp z) (zerop (imagpart z))) (realpart z) z))

(defun almost-real (a)
  "A, without an imaginary part that rounding explains."
  (let ((rest (abs (imagpart (car a)))))
    (if (<= rest (* 100 (cdr a)))
        (cons (realpart (car a)) (+ rest (cdr a)))
        a)))
