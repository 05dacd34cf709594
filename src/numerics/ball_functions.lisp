;;; anmech: functions of balls.
;;;
;;; At a midpoint a function is the sum of a series whose rest is bounded, computed with balls of more binary places;
;;; its argument is brought near zero first.  In a whole ball, functions that rise or fall lie between their values at
;;; the ends; sine and cosine differ from those at the midpoint by no more than the radius.
;;;
;;; Entry points: BALL-OPERATION, BALL-NUMBERS, BALL-POWER.
;;;
;;; Literature: R. P. Brent, P. Zimmermann, Modern Computer Arithmetic (2010), chapter 4.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/balls" "numerics/evaluation")

(defparameter *spare-ball-bits* 24 "Within a function, so many more binary places.")
(defparameter *largest-exponent* 4096 "The exponential function of larger numbers is left alone.")

(defun one-unit () (ash 1 *ball-bits*))
(defun unit-ball () (ball (one-unit) 0))

;;; Constants

(defvar *known-constants* (make-hash-table :test 'equal) "From a name and binary places to balls.")

(defmacro remembered-ball (name &body body)
  `(or (gethash (cons ,name *ball-bits*) *known-constants*)
       (setf (gethash (cons ,name *ball-bits*) *known-constants*)
             (with-more-bits (*spare-ball-bits*) ,@body))))

(defun inverse-series (n sign)
  "The sum of SIGN^i/((2i+1) n^(2i+1)), a ball: the arctangent of 1/n for -1, that of hyperbolic functions for 1."
  (let ((power (floor (one-unit) n)) (sum 0) (factor 1) (i 0))
    (loop until (zerop power)
          do (incf sum (* factor (floor power (1+ (* 2 i)))))
             (setq power (floor power (* n n)) factor (* sign factor))
             (incf i))
    ;; each power is less than two units too small, and each quotient less than one more; of the rest, all together,
    ;; less than three units are left
    (ball sum (+ 3 (* 3 i)))))

(defun ball-pi ()
  "Machin's formula."
  (remembered-ball :pi
    (ball-difference (ball-times (inverse-series 5 -1) 16) (ball-times (inverse-series 239 -1) 4))))

(defun ball-log-2 () (remembered-ball :log-2 (ball-times (inverse-series 3 1) 2)))

(defun constant-ball (name)
  (case name
    (maxima::$%pi (ball-pi))
    (maxima::$%e (ball-exponential (unit-ball)))
    (maxima::$%phi (remembered-ball :phi (ball-halved (ball-sum (unit-ball) (ball-root (ball-of 5))) 1)))
    (t (complain "rigorous = true has no enclosure of ~a" (plain-name name)))))

;;; Exponential function and logarithm

(defun rising-ball (function a)
  "FUNCTION, of integers, which rises, of the ball A."
  (let ((low (funcall function (ball-low a))))
    (if (zerop (ball-radius a))
        low
        (ball-between (ball-low low) (ball-high (funcall function (ball-high a)))))))

(defun exponential-at (integer)
  "By the series of a number below 2^-8, squared again and again."
  (when (> (abs integer) (* *largest-exponent* (one-unit))) (no-ball :exp))
  (let* ((bits *ball-bits*) (halvings (max 0 (+ 8 (- (integer-length integer) bits))))
         (more (+ *spare-ball-bits* (* 2 halvings))))
    (with-more-bits (more)
      (let* ((x (ball-halved (ball (ash integer more) 0) halvings)) (term (unit-ball)) (sum term))
        (loop for i from 1 to (1+ (ceiling *ball-bits* 8))
              do (setq term (ball-over (ball-product term x) i) sum (ball-sum sum term)))
        (setq sum (wider-ball sum 2))
        (loop repeat halvings do (setq sum (ball-square sum)))
        sum))))

(defun ball-exponential (a) (rising-ball #'exponential-at a))

(defun odd-series (z count sign)
  "The sum of SIGN^i z^(2i+1)/(2i+1) for i below COUNT."
  (let ((square (ball-square z)) (power z) (sum z))
    (loop for i from 1 below count
          do (setq power (ball-product power square)
                   sum (ball-sum sum (ball-times (ball-over power (1+ (* 2 i))) (if (oddp i) sign 1)))))
    sum))

(defun logarithm-at (integer)
  "x = 2^e y, y between 0.7 and 1.4: log x = e log 2 + 2 artanh((y - 1)/(y + 1)), where that fraction is below 0.177."
  (unless (plusp integer) (no-ball :log))
  (let* ((length (integer-length integer)) (small (< (* 10 integer) (* 7 (ash 1 length))))
         (exponent (- length *ball-bits* (if small 1 0))) (more (+ *spare-ball-bits* (integer-length exponent)))
         (shift (- more exponent)))
    (with-more-bits (more)
      (let* ((y (if (minusp shift) (ball (ash integer shift) 1) (ball (ash integer shift) 0)))
             (z (ball-quotient (ball-difference y (unit-ball)) (ball-sum y (unit-ball)))))
        (ball-sum (ball-times (ball-log-2) exponent)
                  (ball-times (wider-ball (odd-series z (+ 2 (ceiling *ball-bits* 5)) 1) 1) 2))))))

(defun ball-logarithm (a)
  (unless (plusp (ball-low a)) (no-ball :log))
  (rising-ball #'logarithm-at a))

;;; Sine and cosine

(defun terms-of-circle ()
  "After so many terms the rest of the series of the exponential function at 3.2 is less than four units."
  (let ((bound (one-unit)) (i 0))
    (loop until (and (> i 8) (<= bound 1))
          do (incf i)
             (setq bound (ceiling-quotient (* 16 bound) (* 5 i))))
    i))

(defun circle-at (integer)
  "Sine and cosine: balls."
  (let* ((more (+ *spare-ball-bits* (max 0 (- (integer-length integer) *ball-bits*)))) (sine nil) (cosine nil))
    (let ((*ball-bits* (+ *ball-bits* more)))
      (let* ((turn (ball-times (ball-pi) 2)) (x (ash integer more)) (turns (round x (ball-middle turn)))
             (angle (ball-difference (ball x 0) (ball-times turn turns))) (y (ball (ball-middle angle) 0))
             (term (unit-ball)) (odd (ball 0 0)) (even (unit-ball)))
        (loop for i from 1 below (terms-of-circle)
              do (setq term (ball-over (ball-product term y) i))
                 (let ((signed (if (logbitp 1 i) (ball-negative term) term)))
                   (if (oddp i) (setq odd (ball-sum odd signed)) (setq even (ball-sum even signed)))))
        (setq sine (wider-ball odd (+ 4 (ball-radius angle))) cosine (wider-ball even (+ 4 (ball-radius angle))))))
    (values (ball-shortened sine more) (ball-shortened cosine more))))

(defun within-one (ball)
  "What of BALL is between -1 and 1."
  (let ((one (one-unit)))
    (if (> (ball-size ball) one)
        (ball-between (max (- one) (min one (ball-low ball))) (min one (max (- one) (ball-high ball))))
        ball)))

(defun ball-sine (a)
  (within-one (wider-ball (values (circle-at (ball-middle a))) (ball-radius a))))

(defun ball-cosine (a)
  (within-one (wider-ball (nth-value 1 (circle-at (ball-middle a))) (ball-radius a))))

(defun ball-tangent (a)
  (unless (of-one-sign-p (ball-cosine a)) (no-ball :tan))
  (rising-ball (lambda (integer) (multiple-value-bind (sine cosine) (circle-at integer) (ball-quotient sine cosine)))
               a))

;;; Arctangent and what follows from it

(defun with-spare-bits (function)
  "A function of integers, that which FUNCTION gives of balls that are points."
  (lambda (integer)
    (let ((more (+ *spare-ball-bits* (max 0 (- (integer-length integer) *ball-bits*)))))
      (with-more-bits (more) (funcall function (ball (ash integer more) 0))))))

(defun half-angle (x)
  "The tangent of half the angle whose tangent is X."
  (ball-quotient x (ball-sum (unit-ball) (ball-root (ball-sum (unit-ball) (ball-square x))))))

(defun arctangent-of-point (x)
  "Of an eighth of the angle the tangent is below 0.199."
  (let ((z (half-angle (half-angle (half-angle x)))))
    (ball-times (wider-ball (odd-series z (+ 3 (ceiling (* 2 *ball-bits*) 9)) -1) 1) 8)))

(defun ball-arctangent (a) (rising-ball (with-spare-bits #'arctangent-of-point) a))

(defun root-of-positive (a)
  "The root of what is not below 0, although rounding may say so of a part of the ball."
  (ball-root (ball-between (max 0 (ball-low a)) (max 0 (ball-high a)))))

(defun arcsine-of-point (x)
  (ball-times (ball-arctangent
               (ball-quotient x (ball-sum (unit-ball)
                                          (root-of-positive (ball-difference (unit-ball) (ball-square x))))))
              2))

(defun ball-arcsine (a)
  (if (> (ball-size a) (one-unit)) (no-ball :asin) (rising-ball (with-spare-bits #'arcsine-of-point) a)))

(defun ball-arccosine (a)
  (if (> (ball-size a) (one-unit))
      (no-ball :acos)
      (ball-difference (ball-halved (ball-pi) 1) (ball-arcsine a))))

(defun ball-angle (y x)
  "That of the points (x, y), which must not lie on both sides of the negative axis: it changes by no more than their
distance from the midpoint over that of the nearest of them from the origin."
  (let* ((m (ball-middle x)) (n (ball-middle y)) (p (ball-radius x)) (q (ball-radius y))
         (nearest (isqrt (+ (expt (max 0 (- (abs m) p)) 2) (expt (max 0 (- (abs n) q)) 2)))))
    (when (or (zerop nearest) (and (minusp (ball-low x)) (not (of-one-sign-p y)) (not (equal y '(0 . 0)))))
      (no-ball :atan2))
    (wider-ball (angle-of-points n m)
                (ceiling-quotient (ash (+ p q) *ball-bits*) nearest))))

(defun angle-of-points (y x)
  "Of the point (X, Y), integers."
  (flet ((arctangent (a b) (ball-arctangent (ball-quotient (ball a 0) (ball b 0)))))
    (cond ((< (abs y) x) (arctangent y x))
          ((>= (abs y) (abs x))
           (ball-difference (ball-times (ball-halved (ball-pi) 1) (signum y)) (arctangent x y)))
          (t (ball-sum (arctangent y x) (ball-times (ball-pi) (if (minusp y) -1 1)))))))

;;; Hyperbolic functions

(defun hyperbolic-of-point (x sign)
  (let ((power (ball-exponential x)))
    (ball-halved (ball-sum power (ball-times (ball-inverse power) sign)) 1)))

(defun ball-hyperbolic-sine (a) (rising-ball (with-spare-bits (lambda (x) (hyperbolic-of-point x -1))) a))

(defun ball-hyperbolic-cosine (a)
  "It rises with the size; the ball of sizes may begin one unit below 0, which is given back."
  (let ((low (max 0 (- (abs (ball-middle a)) (ball-radius a)))))
    (wider-ball (rising-ball (with-spare-bits (lambda (x) (hyperbolic-of-point x 1))) (ball-between low (ball-size a)))
                1)))

(defun hyperbolic-tangent-of-point (x)
  "1 - 2/(exp(2x) + 1)"
  (ball-difference (unit-ball)
                   (ball-times (ball-inverse (ball-sum (unit-ball) (ball-exponential (ball-times x 2)))) 2)))

(defun ball-hyperbolic-tangent (a) (rising-ball (with-spare-bits #'hyperbolic-tangent-of-point) a))

(defun area-sine-of-point (x)
  "The logarithm of |x| + sqrt(x^2 + 1), with the sign of x."
  (let ((size (ball (abs (ball-middle x)) (ball-radius x))))
    (ball-times (ball-logarithm (ball-sum size (ball-root (ball-sum (unit-ball) (ball-square size)))))
                (if (minusp (ball-middle x)) -1 1))))

(defun ball-area-sine (a) (rising-ball (with-spare-bits #'area-sine-of-point) a))

(defun area-cosine-of-point (x)
  (ball-logarithm (ball-sum x (root-of-positive (ball-difference (ball-square x) (unit-ball))))))

(defun ball-area-cosine (a)
  (if (< (ball-low a) (one-unit)) (no-ball :acosh) (rising-ball (with-spare-bits #'area-cosine-of-point) a)))

(defun area-tangent-of-point (x)
  (ball-halved (ball-logarithm (ball-quotient (ball-sum (unit-ball) x) (ball-difference (unit-ball) x))) 1))

(defun ball-area-tangent (a)
  (if (>= (ball-size a) (one-unit)) (no-ball :atanh) (rising-ball (with-spare-bits #'area-tangent-of-point) a)))

;;; The error function

(defun error-function-of-point (x)
  "2/sqrt(pi) exp(-x^2) times the sum of 2^i x^(2i+1)/(1*3*..*(2i+1)), which grows as exp(x^2) does.  1 - |erf(x)| is
less than exp(-x^2)."
  (let* ((square (ceiling-shift (ball-high (ball-square x)) *ball-bits*)) (more (* 2 square)))
    (if (> square *ball-bits*)
        (ball (* (signum (ball-middle x)) (one-unit)) 1)
        (with-more-bits (more)
          (let* ((x (ball (ash (ball-middle x) more) (ash (ball-radius x) more))) (square (ball-square x)))
            (ball-quotient (ball-times (ball-product (error-function-sum x square)
                                                     (ball-exponential (ball-negative square)))
                                       2)
                           (ball-root (ball-pi))))))))

(defun error-function-sum (x square)
  "Until the terms are less than half of those before, and nothing: what is left is no more than the last one."
  (let ((term x) (sum x) (i 1))
    (loop until (and (<= (ball-size term) 3) (< (* 4 (ball-high square)) (* i (one-unit))))
          do (incf i 2)
             (setq term (ball-over (ball-times (ball-product term square) 2) i)
                   sum (ball-sum sum term)))
    (wider-ball sum (ball-size term))))

(defun ball-error-function (a) (rising-ball (with-spare-bits #'error-function-of-point) a))

(defun ball-error-complement (a) (ball-difference (unit-ball) (ball-error-function a)))

;;; Powers

(defparameter *most-products* 64 "Higher powers are taken by logarithms.")

(defun exact-exponent (ball)
  "The integer or half of one that BALL is, if it is no large one; nil otherwise."
  (multiple-value-bind (double rest) (floor (* 2 (ball-middle ball)) (one-unit))
    (and (zerop rest) (zerop (ball-radius ball)) (<= (abs double) (* 2 *most-products*)) (/ double 2))))

(defun natural-power (a exponent)
  "EXPONENT is a natural number."
  (cond ((zerop exponent) (unit-ball))
        ((= exponent 1) a)
        ((evenp exponent) (ball-square (natural-power a (/ exponent 2))))
        (t (ball-product a (natural-power a (1- exponent))))))

(defun ball-power (a b)
  (let ((exponent (exact-exponent b)))
    (cond ((null exponent) (ball-exponential (ball-product b (ball-logarithm a))))
          ((minusp exponent) (ball-inverse (ball-power a (ball-negative b))))
          ((integerp exponent) (natural-power a exponent))
          ((minusp (ball-low a)) (no-ball :expt))
          (t (ball-root (natural-power a (* 2 exponent)))))))

;;; All of them

(defparameter *ball-operations*
  '((:add . ball-sum) (:subtract . ball-difference) (:multiply . ball-product) (:divide . ball-quotient)
    (:negate . ball-negative) (:sqrt . ball-root) (:expt . ball-power) (:exp . ball-exponential)
    (:log . ball-logarithm) (:sin . ball-sine) (:cos . ball-cosine) (:tan . ball-tangent) (:asin . ball-arcsine)
    (:acos . ball-arccosine) (:atan . ball-arctangent) (:atan2 . ball-angle) (:sinh . ball-hyperbolic-sine)
    (:cosh . ball-hyperbolic-cosine) (:tanh . ball-hyperbolic-tangent) (:asinh . ball-area-sine)
    (:acosh . ball-area-cosine) (:atanh . ball-area-tangent) (:erf . ball-error-function)
    (:erfc . ball-error-complement)))

(defun ball-operation (operation a &optional b)
  (let ((function (cdr (assoc operation *ball-operations*))))
    (unless function
      (complain "rigorous = true has no enclosure of ~(~a~)" operation))
    (if b (funcall function a b) (funcall function a))))

(defun ball-numbers ()
  "Balls as numbers for programs."
  (make-number-type :number #'ball-of :constant #'constant-ball
                    :operate (lambda (&rest arguments)
                               (handler-case (apply #'ball-operation arguments) (domain-violation () nil)))))
