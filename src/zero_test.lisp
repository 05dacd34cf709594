;;; anmech: is an expression zero?  First step: its value at random points.
;;;
;;; An expression is evaluated in complex double floats together with a bound of the rounding error; a value beyond its
;;; bound proves that the expression is not zero.  Undefined functions have values too: a number made from the name and
;;; the values of the arguments, so that f(a*b) and f(b*a) agree and nothing else does.
;;;
;;; Source: J. T. Schwartz, Fast probabilistic algorithms for verification of polynomial identities, J. ACM 27 (1980) 701;
;;; running error bounds after N. J. Higham, Accuracy and Stability of Numerical Algorithms (2002), section 3.3.
;;;
;;; Entry points: anmech_numeric_zero, anmech_generic_rank.

(in-package :anmech)

(defconstant +unit+ 2.3d-16)

(defvar *seed* 0 "What the random values at the present point are made from.")
(defvar *signs* nil "Whether symbols of unknown sign may be negative at the present point.")

(defun scrambled (text)
  "A number in (0,1) made from TEXT and the seed, the same on every Lisp."
  (let ((state (+ 2166136261 (* 7919 *seed*))))
    (loop for character across text
          do (setq state (mod (* (logxor state (char-code character)) 16777619) 4294967296)))
    (loop repeat 3
          do (setq state (mod (+ (* state 1664525) 1013904223) 4294967296)))
    (/ (+ 0.5d0 state) 4294967296d0)))

(defun symbol-point (symbol)
  "The value of SYMBOL at the present point: of the sign that is known of it, else positive or of either sign."
  (let* ((fraction (scrambled (symbol-name symbol)))
         (size (+ 0.3d0 (* 1.4d0 fraction)))
         (sign (maxima::$csign symbol)))
    (cond ((member sign '(maxima::$neg maxima::$nz)) (- size))
          ((member sign '(maxima::$pos maxima::$pz)) size)
          ((and *signs* (< (scrambled (concatenate 'string "sign of " (symbol-name symbol))) 0.5d0)) (- size))
          (t size))))

(defun undecided () (throw 'undecided :undecided))

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

(defun raise-approximate (base exponent)
  (unless (certainly-nonzero-p base) (if (and (integerp exponent) (> exponent 0)) nil (undecided)))
  (if (integerp exponent)
      (let ((value (expt (car base) exponent)))
        (approximate value (if (zerop (abs (car base)))
                               0d0
                               (* (abs exponent) (abs (/ value (car base))) (+ (cdr base) (* +unit+ (abs (car base))))))))
      (let ((logarithm (log (car base))))
        (let ((value (exp (* (car exponent) logarithm))))
          (approximate value (* (abs value)
                                (+ (* (abs (car exponent)) (/ (cdr base) (abs (car base))))
                                   (* (+ (cdr exponent) (* +unit+ (abs (car exponent)))) (abs logarithm)))))))))

(defparameter *derivative-bounds*
  `((maxima::%sin ,#'sin ,(lambda (z f) (declare (ignore f)) (cosh (imagpart z))))
    (maxima::%cos ,#'cos ,(lambda (z f) (declare (ignore f)) (cosh (imagpart z))))
    (maxima::%tan ,#'tan ,(lambda (z f) (declare (ignore z)) (+ 1 (expt (abs f) 2))))
    (maxima::%log ,#'log ,(lambda (z f) (declare (ignore f)) (/ 1 (abs z))))
    (maxima::%sinh ,#'sinh ,(lambda (z f) (declare (ignore f)) (cosh (realpart z))))
    (maxima::%cosh ,#'cosh ,(lambda (z f) (declare (ignore f)) (cosh (realpart z))))
    (maxima::%tanh ,#'tanh ,(lambda (z f) (declare (ignore z)) (+ 1 (expt (abs f) 2))))
    (maxima::%atan ,#'atan ,(lambda (z f) (declare (ignore f)) (/ 1 (abs (+ 1 (* z z))))))
    (maxima::%asinh ,#'asinh ,(lambda (z f) (declare (ignore f)) (/ 1 (sqrt (abs (+ 1 (* z z)))))))
    (maxima::%asin ,#'asin ,(lambda (z f) (declare (ignore f)) (/ 1 (sqrt (abs (- 1 (* z z)))))))
    (maxima::%acos ,#'acos ,(lambda (z f) (declare (ignore f)) (/ 1 (sqrt (abs (- 1 (* z z)))))))
    (maxima::mabs ,(lambda (z) (abs z)) ,(lambda (z f) (declare (ignore z f)) 1d0))
    (maxima::%signum ,(lambda (z) (if (complexp z) (undecided) (signum z)))
     ,(lambda (z f) (declare (ignore z f)) 0d0)))
  "Functions with a bound of their derivative's size at z, f being the value there.")

(defun reciprocal-function (operator)
  (cdr (assoc operator '((maxima::%sec . maxima::%cos) (maxima::%csc . maxima::%sin) (maxima::%cot . maxima::%tan)
                         (maxima::%sech . maxima::%cosh) (maxima::%csch . maxima::%sinh)
                         (maxima::%coth . maxima::%tanh)))))

(defun real-if-real (z)
  (if (and (complexp z) (zerop (imagpart z))) (realpart z) z))

(defun point-value (form)
  "FORM at the present point, as (value . bound)."
  (cond ((numberp form) (approximate (coerce form 'double-float) 0d0))
        ((eq form 'maxima::$%pi) (approximate pi 0d0))
        ((eq form 'maxima::$%e) (approximate (exp 1d0) 0d0))
        ((eq form 'maxima::$%i) (cons #c(0d0 1d0) 0d0))
        ((member form '(maxima::$inf maxima::$minf maxima::$infinity maxima::$und maxima::$ind nil t)) (undecided))
        ((symbolp form) (cons (symbol-point form) 0d0))
        ((atom form) (undecided))
        (t (operation-value form))))

(defun operation-value (form)
  (let ((operator (caar form)))
    (case operator
      (maxima::rat (approximate (coerce (/ (second form) (third form)) 'double-float) 0d0))
      (maxima::bigfloat (point-value (maxima::$float form)))
      (maxima::mplus (reduce #'add-approximate (mapcar #'point-value (rest form))))
      (maxima::mtimes (reduce #'multiply-approximate (mapcar #'point-value (rest form))))
      (maxima::mexpt (power-value (second form) (third form)))
      (t (function-value operator form)))))

(defun power-value (base exponent)
  (if (integerp exponent)
      (raise-approximate (point-value base) exponent)
      (raise-approximate (point-value base) (point-value exponent))))

(defun function-value (operator form)
  (let ((known (assoc operator *derivative-bounds*))
        (reciprocal (reciprocal-function operator)))
    (cond (known (destructuring-bind (function bound) (rest known)
                   (let* ((argument (point-value (second form)))
                          (z (real-if-real (car argument)))
                          (value (real-if-real (funcall function z))))
                     (approximate value (* (+ (cdr argument) (* +unit+ (abs z)))
                                           (abs (funcall bound z value)))))))
          (reciprocal (raise-approximate (function-value reciprocal form) -1))
          ((member 'maxima::array (first form)) (cons (+ 0.3d0 (scrambled (plain-name form))) 0d0))
          ((eq operator 'maxima::%derivative) (unknown-derivative form))
          ((and (symbolp operator) (char= (char (symbol-name operator) 0) #\$) (not (fboundp operator)))
           (unknown-value (symbol-name operator) (rest form)))
          (t (undecided)))))

(defun unknown-value (name arguments)
  "An undefined function is a number made from its name and the values of its arguments."
  (cons (+ 0.3d0 (scrambled (format nil "~a~{ ~a~}" name
                                    (mapcar (lambda (argument) (rounded-text (car (point-value argument))))
                                            arguments))))
        0d0))

(defun rounded-text (z)
  (format nil "~d ~d" (round (* 1d8 (realpart z))) (round (* 1d8 (imagpart z)))))

(defun unknown-derivative (form)
  "A derivative of an undefined function of its own arguments: another undefined function of them."
  (let ((function (second form)))
    (when (or (atom function) (assoc (caar function) *derivative-bounds*)
              (member (caar function) '(maxima::mplus maxima::mtimes maxima::mexpt maxima::%integrate maxima::%sum)))
      (if (symbolp function)
          (return-from unknown-derivative (cons (+ 0.3d0 (scrambled (plain-name form))) 0d0))
          (undecided)))
    (unknown-value (format nil "~a~{ ~a~}" (caar function)
                           (loop for (variable order) on (cddr form) by #'cddr
                                 collect (or (position variable (rest function) :test #'equal) (undecided))
                                 collect order))
                   (rest function))))

(defun value-at-point (form)
  "(value . bound), or :undecided where FORM has no value in double floats."
  (catch 'undecided
    (handler-case
        (let ((approximate (point-value form)))
          (if (and (= (car approximate) (car approximate)) (< (abs (car approximate)) 1d250) (< (cdr approximate) 1d250))
              approximate
              :undecided))
      (error () :undecided))))

(defun numeric-zero (form &optional (points 4))
  "nil if FORM is certainly not zero; t if it is zero within rounding at several points; :undecided else."
  (let ((seen 0))
    (dotimes (k (* 2 points) (if (plusp seen) t :undecided))
      (let* ((*seed* k) (*signs* (and (oddp k) (not (branched-p form)))) (value (value-at-point form)))
        (unless (eq value :undecided)
          (when (certainly-nonzero-p value) (return nil))
          (when (= (incf seen) points) (return t)))))))

(maxima::defmfun maxima::$anmech_numeric_zero (form)
  "anmech_numeric_zero(expr): false = certainly not zero; true = zero at several points; unknown."
  (let ((answer (numeric-zero form)))
    (if (eq answer :undecided) 'maxima::$unknown answer)))

;;; Rank at random points: the generic one, with certainty from below

(defun numeric-rank (rows)
  "Rank of ROWS, a list of vectors of numbers, by elimination with complete pivoting."
  (let ((rank 0) (rows (mapcar #'copy-seq rows)))
    (loop
      (let ((pivot 0d0) (best nil) (column 0))
        (dolist (row rows)
          (dotimes (j (length row))
            (when (> (abs (aref row j)) pivot) (setq pivot (abs (aref row j)) best row column j))))
        (when (< pivot 1d-9) (return rank))
        (incf rank)
        (setq rows (remove best rows))
        (dolist (row rows)
          (let ((factor (/ (aref row column) (aref best column))))
            (dotimes (j (length row)) (decf (aref row j) (* factor (aref best j))))
            (setf (aref row column) 0d0)))))))

(defun scaled-row (row)
  (let ((size (reduce #'max (map 'list #'abs row))))
    (if (zerop size) row (map 'vector (lambda (x) (/ x size)) row))))

(defun rank-at-point (rows)
  (let ((values (mapcar (lambda (row) (mapcar #'value-at-point row)) rows)))
    (if (some (lambda (row) (member :undecided row)) values)
        nil
        (numeric-rank (mapcar (lambda (row) (scaled-row (map 'vector #'car row))) values)))))

(maxima::defmfun maxima::$anmech_generic_rank (matrix)
  "anmech_generic_rank(matrix): rank at generic values of everything in it, or unknown."
  (let* ((rows (mapcar #'rest (rest matrix)))
         (ranks (loop for seed below 4 collect (let ((*seed* seed)) (rank-at-point rows)))))
    (if (every #'null ranks) 'maxima::$unknown (reduce #'max (remove nil ranks)))))
