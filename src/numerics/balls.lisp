;;; anmech: balls: intervals of real numbers, as midpoints with radii.
;;;
;;; A *ball* is a pair (midpoint . radius) of integers in units of 2^-*BALL-BITS*; it stands for all real numbers that
;;; are not farther than the radius from the midpoint.  What an operation gives holds the values that it has anywhere
;;; in the balls it is given: the integers are exact, what is cut off of a midpoint is added to the radius, and radii
;;; are rounded upwards.  No floating point takes part.  Where operands have one sign the ball is the smallest that
;;; holds the values; where signs are open it may be wider, never narrower.
;;;
;;; Entry points: *BALL-BITS*; BALL, BALL-MIDDLE, BALL-RADIUS, BALL-OF, BALL-BETWEEN, BALL-LOW, BALL-HIGH, BALL-SIZE,
;;; BALL-VALUE; BALL-SUM, BALL-DIFFERENCE, BALL-NEGATIVE, BALL-PRODUCT, BALL-SQUARE, BALL-INVERSE, BALL-QUOTIENT,
;;; BALL-ROOT, BALL-TIMES, BALL-OVER, WIDER-BALL, BALL-HALVED, WITH-MORE-BITS; CEILING-SHIFT, CEILING-QUOTIENT,
;;; NO-BALL.
;;;
;;; Literature: R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval Analysis (2009), chapter 2; J. van
;;; der Hoeven, Ball arithmetic (2009).

(in-package :anmech)
(needs "arithmetic/floats")

(defvar *ball-bits* 128 "The binary places of midpoints and radii.")

(declaim (inline ball ball-middle ball-radius))
(defun ball (middle radius) (cons middle radius))
(defun ball-middle (ball) (car ball))
(defun ball-radius (ball) (cdr ball))

(defun no-ball (operation)
  "Complain that OPERATION has no value somewhere in the balls it is given."
  (error 'domain-violation :operation operation :source nil))

;;; Rounding upwards

(declaim (inline ceiling-shift))
(defun ceiling-shift (integer bits)
  "INTEGER over 2^BITS, rounded upwards."
  (- (ash (- integer) (- bits))))

(defun ceiling-quotient (integer divisor)
  (values (ceiling integer divisor)))

;;; In and out

(defun ball-of (number)
  "The ball of the rational NUMBER."
  (multiple-value-bind (middle rest) (floor (ash (numerator number) *ball-bits*) (denominator number))
    (ball middle (if (zerop rest) 0 1))))

(defun ball-between (low high)
  "The ball of all that is between LOW and HIGH, integers in units."
  (let ((middle (ash (+ low high) -1)))
    (ball middle (- high middle))))

(defun ball-low (ball) (- (ball-middle ball) (ball-radius ball)))
(defun ball-high (ball) (+ (ball-middle ball) (ball-radius ball)))

(defun ball-size (ball)
  "The largest size of a number in BALL, in units."
  (+ (abs (ball-middle ball)) (ball-radius ball)))

(defun ball-value (integer)
  "The rational number that INTEGER units are."
  (/ integer (ash 1 *ball-bits*)))

(defun wider-ball (ball units)
  (ball (ball-middle ball) (+ (ball-radius ball) units)))

(defmacro with-more-bits ((more) &body body)
  "The ball that BODY gives, which has MORE binary places there."
  (let ((guard (gensym)) (found (gensym)))
    `(let* ((,guard ,more)
            (,found (let ((*ball-bits* (+ *ball-bits* ,guard))) ,@body)))
       (ball-shortened ,found ,guard))))

(defun ball-shortened (ball bits)
  "BALL in units that are larger by 2^BITS."
  (if (zerop bits)
      ball
      (ball (ash (ball-middle ball) (- bits)) (1+ (ceiling-shift (ball-radius ball) bits)))))

;;; Operations

(defun ball-sum (a b)
  (ball (+ (ball-middle a) (ball-middle b)) (+ (ball-radius a) (ball-radius b))))

(defun ball-difference (a b)
  (ball (- (ball-middle a) (ball-middle b)) (+ (ball-radius a) (ball-radius b))))

(defun ball-negative (a) (ball (- (ball-middle a)) (ball-radius a)))

(defun of-one-sign-p (ball) (> (abs (ball-middle ball)) (ball-radius ball)))

(defun ball-product (a b)
  (let ((m (ball-middle a)) (r (ball-radius a)) (n (ball-middle b)) (s (ball-radius b)))
    (flet ((in-units (middle radius)
             (if (and (eql middle 0) (eql radius 0))
                 (ball 0 0)
                 (ball (ash middle (- *ball-bits*)) (1+ (ceiling-shift radius *ball-bits*)))))
           (far-end (m r) (if (minusp m) (- m r) (+ m r))))
      (cond ((and (of-one-sign-p a) (of-one-sign-p b))
             (in-units (+ (* m n) (* (signum m) (signum n) r s)) (+ (* (abs m) s) (* r (abs n)))))
            ((of-one-sign-p a) (in-units (* (far-end m r) n) (* (abs (far-end m r)) s)))
            ((of-one-sign-p b) (in-units (* m (far-end n s)) (* r (abs (far-end n s)))))
            (t (in-units (* m n) (+ (* (abs m) s) (* r (+ (abs n) s)))))))))

(defun ball-square (a)
  (let ((m (ball-middle a)) (r (ball-radius a)))
    (if (of-one-sign-p a)
        (ball (ash (+ (* m m) (* r r)) (- *ball-bits*)) (1+ (ceiling-shift (* 2 (abs m) r) *ball-bits*)))
        (ball-between 0 (ceiling-shift (expt (+ (abs m) r) 2) *ball-bits*)))))

(defun ball-inverse (a)
  "Between 1/(m + r) and 1/(m - r) lies m/(m^2 - r^2), give or take r/(m^2 - r^2)."
  (unless (of-one-sign-p a) (no-ball :divide))
  (let* ((m (ball-middle a)) (r (ball-radius a)) (divisor (- (* m m) (* r r))) (bits (* 2 *ball-bits*)))
    (ball (floor (ash m bits) divisor) (1+ (ceiling-quotient (ash r bits) divisor)))))

(defun ball-quotient (a b) (ball-product a (ball-inverse b)))

(defun ball-root (a)
  (when (minusp (ball-low a)) (no-ball :sqrt))
  (ball-between (isqrt (ash (ball-low a) *ball-bits*)) (1+ (isqrt (ash (ball-high a) *ball-bits*)))))

(defun ball-times (a integer)
  (ball (* integer (ball-middle a)) (* (abs integer) (ball-radius a))))

(defun ball-over (a integer)
  "A over the positive INTEGER."
  (multiple-value-bind (middle rest) (floor (ball-middle a) integer)
    (ball middle (+ (if (eql rest 0) 0 1) (ceiling-quotient (ball-radius a) integer)))))

(defun ball-halved (a times)
  "A over 2^TIMES."
  (let ((middle (ash (ball-middle a) (- times))))
    (ball middle (+ (if (= (ash middle times) (ball-middle a)) 0 1) (ceiling-shift (ball-radius a) times)))))
