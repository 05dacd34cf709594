;;; anmech: numbers of many digits: rational numbers, rounded to so many bits.
;;;
;;; They serve where few are computed, where a step begins and where a motion is read; the many products between are
;;; sums of integers (long_series.lisp).  Functions are left to Maxima's bigfloats; but sine and cosine, which every
;;; step of what turns begins with, are found together, five times as fast.
;;;
;;; Their exponents are of any size, as far as sums and products go; a function that is larger than 2^*MOST-BINARY* is
;;; a domain violation, and one that is smaller than its reciprocal vanishes: so nobody waits for a number of millions
;;; of digits.
;;;
;;; Entry points: ROUNDED, BINARY-LOGARITHM, BITS-OF-DIGITS, DIGITS-OF-BITS, LONG-OPERATION, LONG-NUMBERS,
;;; LONG-INVERSE, BIGFLOAT-NEAR, NEAREST-FINITE-DOUBLE, *MORE-DIGITS*, *MOST-BINARY*.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/dag" "numerics/doubles" "numerics/evaluation" "numerics/operations")

(defun bits-of-digits (digits)
  (ceiling (* digits (log 10d0 2d0))))

(defun rounded (number bits)
  "The rational NUMBER to BITS significant bits, as k*2^e."
  (if (and (integerp number) (<= (integer-length number) bits))
      number
      (let* ((above (numerator number)) (below (denominator number))
             (shift (- bits (- (integer-length above) (integer-length below))))
             (mantissa (if (minusp shift) (round above (ash below (- shift))) (round (ash above shift) below))))
        (if (minusp shift) (ash mantissa (- shift)) (/ mantissa (ash 1 shift))))))

(defun binary-logarithm (number)
  "That of the size of the rational NUMBER, not 0, a double however large or small the number is."
  (flet ((of-integer (integer)
           (let ((extra (max 0 (- (integer-length integer) 60))))
             (+ extra (log (coerce (ash integer (- extra)) 'double-float) 2d0)))))
    (- (of-integer (abs (numerator number))) (of-integer (denominator number)))))

;;; Operations

(defparameter *functions-of-maxima*
  '((:sqrt . maxima::%sqrt) (:exp . maxima::%exp) (:log . maxima::%log) (:tan . maxima::%tan)
    (:asin . maxima::%asin) (:acos . maxima::%acos) (:atan . maxima::%atan)
    (:sinh . maxima::%sinh) (:cosh . maxima::%cosh) (:tanh . maxima::%tanh) (:asinh . maxima::%asinh)
    (:acosh . maxima::%acosh) (:atanh . maxima::%atanh) (:erf . maxima::%erf) (:erfc . maxima::%erfc)))

(defun in-domain-p (operation a &optional (b 0))
  (let ((domain (second (assoc operation *domains*))))
    (or (null domain)
        (ecase (first domain)
          ((/= or) (if (eq operation :divide) (/= b 0) (or (plusp a) (and (zerop a) (plusp b)))))
          (>= (>= a (third domain)))
          (> (> a (third domain)))
          (<= (<= (second domain) a (fourth domain)))
          (< (< (second domain) a (fourth domain)))))))

(defun long-operation (operation bits a &optional (b 0))
  "OPERATION of the rational numbers A and B to BITS bits, nil outside of its domain."
  (when (in-domain-p operation a b)
    (case operation
      (:add (rounded (+ a b) bits))
      (:subtract (rounded (- a b) bits))
      (:multiply (rounded (* a b) bits))
      (:divide (rounded (/ a b) bits))
      (:negate (- a))
      (:abs (abs a))
      (:signum (signum a))
      (:floor (floor a))
      (:max (max a b))
      (:min (min a b))
      (:sqrt (long-root a bits))
      (:expt (long-power a b bits))
      (:atan2 (long-angle a b bits))
      (:sin (values (long-circle a bits)))
      (:cos (nth-value 1 (long-circle a bits)))
      (:tan (multiple-value-bind (sine cosine) (long-circle a (+ bits 3)) (rounded (/ sine cosine) bits)))
      (t (long-function-of operation a bits)))))

(defparameter *most-binary* 100000)

(defun too-large () (error 'domain-violation :operation :overflow :source nil))

(defun long-function-of (operation a bits)
  "Of the odd ones only the positive half is asked for: Maxima finds no end to atan(-2b0^-100)."
  (when (and (minusp a) (member operation '(:asin :atan :sinh :tanh :asinh :atanh :erf)))
    (return-from long-function-of (- (long-function-of operation (- a) bits))))
  (flet ((value (bits)
           (long-function (list (list (cdr (assoc operation *functions-of-maxima*))) (bigfloat-form a)) bits)))
    (case operation
      ((:exp :sinh :cosh) (cond ((< (abs a) (* *most-binary* 7/10)) (value bits))
                                ((and (eq operation :exp) (minusp a)) 0)
                                (t (too-large))))
      (:erfc (if (< (* a (abs a)) (* *most-binary* 7/10)) (value bits) 0))
      ((:log :asin :acos :acosh :atanh)                 ; near 1 they are what the last bits of A are
       (let ((rest (- (abs a) 1)))
         (rounded (value (if (zerop rest) bits (+ bits (max 0 (- (floor (binary-logarithm rest))))))) bits)))
      (t (value bits)))))

(defun long-power (base exponent bits)
  (cond ((zerop base) 0)
        ((and (integerp (* 2 exponent)) (< (abs exponent) 64))
         (let ((power (expt (rounded base (+ bits 16)) (* 2 (abs exponent)))))
           (long-root (if (minusp exponent) (/ power) power) bits)))
        ((zerop exponent) 1)
        (t (let ((size (* exponent (rational (binary-logarithm base)))))
             (cond ((< (abs size) *most-binary*)
                    (long-function `((maxima::mexpt) ,(bigfloat-form base) ,(bigfloat-form exponent)) bits))
                   ((minusp size) 0)
                   (t (too-large)))))))

(defun bigfloat-form (number)
  "What is evaluated to a bigfloat: rational numbers would be factored by some functions."
  `((maxima::$bfloat) ,(from-rational number)))

(defun long-angle (y x bits)
  "That of the point x, y: not all Maximas know atan2 of bigfloats."
  (flet ((part (y x) (long-operation :atan (+ bits 3) (rounded (/ y x) (+ bits 3))))
         (turns (number) (* number (if (minusp y) -1 1) (long-function 'maxima::$%pi (+ bits 3)))))
    (rounded (cond ((> (abs y) (abs x)) (- (turns 1/2) (part x y)))
                   ((plusp x) (part y x))
                   ((zerop y) (turns 1))
                   (t (+ (turns 1) (part y x))))
             bits)))

(defun long-root (number bits)
  (if (zerop number)
      0
      (let* ((above (numerator number)) (below (denominator number))
             (half (ceiling (- (* 2 (+ bits 1)) (- (integer-length above) (integer-length below))) 2))
             (scaled (if (minusp half) (floor above (ash below (* -2 half))) (floor (ash above (* 2 half)) below)))
             (root (isqrt scaled)))
        (rounded (if (minusp half) (ash root (- half)) (/ root (ash 1 half))) bits))))

(defun long-function (form bits)
  (let ((value (with-digits (digits-of-bits (+ bits 8)) `((maxima::$bfloat) ,form))))
    (rounded (if (rationalp value) value (bigfloat-value value nil)) bits)))

;;; Sine and cosine

(defparameter *most-turns* 10000 "A binary logarithm.")

(defvar *last-circle* '(nil nil) "A number, bits, and what LONG-CIRCLE gave of them: both values are asked for.")

(defun long-circle (number bits)
  "Sine and cosine of the rational NUMBER to BITS significant bits."
  (when (> (integer-length (truncate number)) *most-turns*) (too-large))
  (unless (and (eql number (first *last-circle*)) (eql bits (second *last-circle*)))
    (setq *last-circle* (list number bits (circle-to-bits number bits))))
  (values-list (third *last-circle*)))

(defun circle-to-bits (number bits)
  "A list; near a zero with so many more places."
  (if (zerop number)
      (list 0 1)
      (loop with more = (max 0 (- (floor (binary-logarithm number))))
            do (multiple-value-bind (sine cosine spare) (circle-in-places number (+ bits more 4))
                 (let ((known (- (min (integer-length sine) (integer-length cosine)) spare))
                       (unit (ash 1 (+ bits more 4 spare))))
                   (if (< known (+ bits 2))
                       (setq more (+ more (- (+ bits 3) known)))
                       (return (list (rounded (/ sine unit) bits) (rounded (/ cosine unit) bits)))))))))

(defun circle-in-places (number places)
  "Sine and cosine, integers, of so many binary PLACES and of more that are not known; and how many those are.  By the
series of a part of the angle, which is doubled again and again: a doubling takes one place at most, and what is cut off
in all of them another three or four."
  (let* ((halvings (max 0 (+ (ceiling (binary-logarithm number)) (floor (isqrt places) 3/2))))
         (all (+ places halvings 4))
         (part (floor (ash (abs (numerator number)) (- all halvings)) (denominator number)))
         (term (ash 1 all)) (sine 0) (cosine 0))
    (loop for i from 0
          until (zerop term)
          do (let ((signed (if (logbitp 1 i) (- term) term)))
               (if (oddp i) (incf sine signed) (incf cosine signed)))
             (setq term (floor (ash (* term part) (- all)) (1+ i))))
    (loop repeat halvings
          do (psetq sine (ash (* sine cosine) (- 1 all))
                    cosine (ash (* (- cosine sine) (+ cosine sine)) (- all))))
    (values (if (minusp number) (- sine) sine) cosine (- all places))))

(defun digits-of-bits (bits)
  (ceiling bits (log 10d0 2d0)))

(defun long-numbers (bits)
  "Such numbers, for programs."
  (make-number-type :number (lambda (number) (rounded number bits))
                    :constant (lambda (name) (long-function name bits))
                    :operate (lambda (operation a &optional (b 0)) (long-operation operation bits a b))))

(defparameter *more-digits* 4
  "Of bigfloats that are handed out, beyond those that were asked for: that rounding adds little to the error.")

(defun bigfloat-near (number digits)
  "Maxima's bigfloat of so many digits next to the rational NUMBER."
  (with-digits digits (bigfloat-form number)))

(defun nearest-finite-double (number)
  "Of what is too large for a double, the largest one."
  (let ((largest (rational most-positive-double-float)))
    (to-double (max (- largest) (min largest number)))))

;;; A u = b

;; In elimination numbers are pairs of a mantissa and an exponent of two: sums and products of fractions would look for
;; common divisors.

(defun long-pair (number bits)
  (let ((number (rounded number bits)))
    (cons (numerator number) (- 1 (integer-length (denominator number))))))

(defun shortened-pair (mantissa exponent bits)
  (let ((excess (- (integer-length mantissa) bits)))
    (if (plusp excess)
        (cons (ash mantissa (- excess)) (+ exponent excess))
        (cons mantissa exponent))))

(defun product-of-pairs (x y bits)
  (shortened-pair (* (car x) (car y)) (+ (cdr x) (cdr y)) bits))

(defun difference-of-pairs (x y bits)
  (let ((exponent (min (cdr x) (cdr y))))
    (shortened-pair (- (ash (car x) (- (cdr x) exponent)) (ash (car y) (- (cdr y) exponent))) exponent bits)))

(defun reciprocal-of-pair (x bits)
  (let ((places (+ bits (integer-length (car x)))))
    (cons (floor (ash 1 places) (car x)) (- (+ places (cdr x))))))

(defun magnitude-of-pair (x)
  "About the binary logarithm of X, nil of 0."
  (and (/= 0 (car x)) (+ (integer-length (car x)) (cdr x))))

(defun long-inverse (rows bits)
  "The inverse of a matrix, a list of rows: a vector of vectors; nil if it is singular."
  (let* ((n (length rows)) (bits (+ bits 8))
         (rows (coerce (loop for row in rows
                             for i from 0
                             collect (map 'vector (lambda (number) (long-pair number bits))
                                          (append row (loop for j below n collect (if (= i j) 1 0)))))
                       'vector)))
    (dotimes (k n)
      (let ((pivot (pivot-place rows k n)))
        (unless pivot (return-from long-inverse nil))
        (rotatef (aref rows k) (aref rows pivot))
        (let* ((row (aref rows k)) (inverse (reciprocal-of-pair (aref row k) bits)))
          (map-into row (lambda (x) (product-of-pairs inverse x bits)) row)
          (dotimes (i n)
            (let ((part (aref (aref rows i) k)))
              (unless (or (= i k) (eql 0 (car part)))
                (map-into (aref rows i)
                          (lambda (x y)
                            (if (eql 0 (car y)) x (difference-of-pairs x (product-of-pairs part y bits) bits)))
                          (aref rows i) row)))))))
    (map 'vector (lambda (row)
                   (map 'vector (lambda (x) (* (car x) (expt 2 (cdr x)))) (subseq row n)))
         rows)))

(defun pivot-place (rows column n)
  "The row from COLUMN on whose entry there is largest in proportion to the others: units of equations do not decide."
  (let ((best nil) (largest nil))
    (loop for i from column below n
          for sizes = (map 'list #'magnitude-of-pair (subseq (aref rows i) column n))
          for size = (reduce #'max (remove nil sizes) :initial-value most-negative-fixnum)
          do (when (and (first sizes) (or (null best) (> (- (first sizes) size) largest)))
               (setq largest (- (first sizes) size) best i)))
    best))
