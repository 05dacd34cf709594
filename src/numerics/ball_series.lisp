;;; anmech: power series whose coefficients are balls.
;;;
;;; A *ball field* finds the Taylor coefficients of all states, and of their derivatives by the states where they begin,
;;; from a straight-line program of the rates; it is given balls of states and of the time, and each coefficient is a
;;; ball that holds what it is from anywhere in them.  Time is counted in steps, so coefficients fade.  Of the
;;; derivatives Y, Y' = A Y, where A holds the derivatives of the rates, which are results of the same program.
;;;
;;; Entry points: the structure BALL-FIELD; NEW-BALL-FIELD, VARIED-PROGRAM, EXPAND-BALLS, STATE-COEFFICIENT,
;;; VARIATION-COEFFICIENT.
;;;
;;; Literature: R. E. Moore, Interval Analysis (1966), chapter 11; N. S. Nedialkov, K. R. Jackson, G. F. Corliss,
;;; Applied Mathematics and Computation 105 (1999) 21-68.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/ball_functions" "numerics/balls" "numerics/differentiation"
       "numerics/series_program" "numerics/sharing")

(defstruct (ball-series (:print-function print-dots))
  (middles #() :type simple-vector)
  (radii #() :type simple-vector)
  (sizes nil))                    ; of thin balls: vector, in units of 2^-*SIZE-BITS*, rounded upwards; else nil

(defvar *size-bits* 30 "Of sizes that only take part in radii; more where numbers are small.")

(defun new-ball-series (order thin)
  (flet ((numbers () (make-array (1+ order) :initial-element 0)))
    (make-ball-series :middles (numbers) :radii (numbers) :sizes (and thin (numbers)))))

(defun ball-coefficient (series k)
  (ball (svref (ball-series-middles series) k) (svref (ball-series-radii series) k)))

(defun put-coefficient (series k ball)
  (setf (svref (ball-series-middles series) k) (ball-middle ball)
        (svref (ball-series-radii series) k) (ball-radius ball))
  (let ((sizes (ball-series-sizes series)))
    (when sizes
      (setf (svref sizes k)
            (let ((size (ball-size ball)))
              (if (eql size 0) 0 (1+ (ash size (- *size-bits* *ball-bits*)))))))))

;;; Sums of products: exact, shortened once.  Where balls are thin, their sizes need few bits to bound the radius.

(defmacro define-ball-sum (name arguments weight documentation)
  "A function (a b k from to . ARGUMENTS) of two series: the sum over j = FROM .. TO of WEIGHT, an integer, times a[j]
b[k-j], a ball."
  (flet ((sum (vectors bits &rest step)
           `(let ((middle 0) (radius 0) ,@vectors)
              (declare (simple-vector ,@(mapcar #'first vectors)))
              (do ((j from (the fixnum (1+ j)))
                   (i (the fixnum (- k from)) (the fixnum (1- i))))
                  ((> j to) (shortened-sum middle radius ,bits))
                (declare (fixnum j i))
                ,@step)))
         (vectors (slots)
           (loop for slot in slots
                 append (loop for series in '(a b)
                              collect `(,(intern (format nil "~a-~a" series slot) :anmech)
                                        (,(intern (format nil "BALL-SERIES-~a" slot) :anmech) ,series))))))
    `(defun ,name (a b k from to ,@arguments)
       ,documentation
       (declare (fixnum k from to ,@arguments) (optimize (speed 3) (safety 0)))
       (if (and (ball-series-sizes a) (ball-series-sizes b))
           ,(sum (vectors '(middles radii sizes)) '*size-bits*
                 `(let ((m (svref a-middles j)) (n (svref b-middles i)) (r (svref a-radii j)) (s (svref b-radii i)))
                    (unless (or (eql m 0) (eql n 0))
                      (setq middle (+ middle ,(times-weight weight '(* m n)))))
                    (unless (eql r 0)
                      (setq radius (+ radius ,(times-weight `(abs ,weight) '(* r (svref b-sizes i))))))
                    (unless (eql s 0)
                      (setq radius (+ radius ,(times-weight `(abs ,weight) '(* s (svref a-sizes j))))))))
           ,(sum (vectors '(middles radii)) '*ball-bits*
                 `(let ((m (svref a-middles j)) (r (svref a-radii j)) (n (svref b-middles i)) (s (svref b-radii i)))
                    (unless (and (eql n 0) (eql s 0))
                      (unless (eql m 0)
                        (setq middle (+ middle ,(times-weight weight '(* m n))))
                        (unless (eql s 0)
                          (setq radius (+ radius ,(times-weight `(abs ,weight) '(* (abs m) s))))))
                      (unless (eql r 0)
                        (setq radius (+ radius ,(times-weight `(abs ,weight) '(* r (+ (abs n) s)))))))))))))

(defun shortened-sum (middle radius bits)
  (if (and (eql middle 0) (eql radius 0))
      (ball 0 0)
      (ball (ash middle (- *ball-bits*)) (1+ (ceiling-shift radius bits)))))

(eval-when (:compile-toplevel :load-toplevel :execute)
  (defun times-weight (weight form)
    (if (member weight '(1 (abs 1)) :test #'equal) form `(* (the fixnum ,weight) ,form))))

(define-ball-sum ball-products () 1 "The sum of a[j] b[k-j].")
(define-ball-sum weighted-ball-products () j "The sum of j a[j] b[k-j].")
(define-ball-sum power-products (p q) (the fixnum (- (the fixnum (* p j)) (the fixnum (* q i))))
  "The sum of (p j - q (k-j)) a[j] b[k-j].")

;;; Instructions

(defun exact-constants (program)
  "Of each constant of a series PROGRAM that is made of numbers alone, the rational number; of others nil."
  (let ((values (make-array (length (series-program-constants program)) :initial-element nil)))
    (dotimes (i (length values) values)
      (destructuring-bind (head . rest) (aref (series-program-constants program) i)
        (setf (aref values i)
              (case head
                (:number rest)
                ((:add :subtract :multiply :negate)
                 (let ((operands (mapcar (lambda (c) (aref values c)) rest)))
                   (and (notany #'null operands)
                        (apply (ecase head (:add #'+) ((:subtract :negate) #'-) (:multiply #'*)) operands))))))))))

(defun signed-ball (ball sign) (if (minusp sign) (ball-negative ball) ball))

(defun ball-advancer (instruction result series constant exact)
  "The function (k) that finds coefficient k of RESULT; SERIES and CONSTANT give those of a number, EXACT a rational
constant or nil."
  (destructuring-bind (operation a &optional b c d) instruction
    (let ((inverse nil))
      (labels ((series (number) (funcall series number))
               (at (series k) (ball-coefficient series k))
               (put (k ball) (put-coefficient result k ball))
               (under (k divisor dividend)
                 "The quotient by coefficient 0 of DIVISOR, whose inverse is kept."
                 (when (<= k 1) (setq inverse (ball-inverse (at divisor 0))))
                 (put k (ball-product dividend inverse)))
               (first-value (k operation &rest operands)
                 (put k (apply #'ball-operation operation operands))))
        (ecase operation
          ((:add :subtract)
           (let ((a (series a)) (b (series b)))
             (if (eq operation :add)
                 (lambda (k) (put k (ball-sum (at a k) (at b k))))
                 (lambda (k) (put k (ball-difference (at a k) (at b k)))))))
          (:negate (let ((a (series a))) (lambda (k) (put k (ball-negative (at a k))))))
          (:shift (let ((a (series a)) (number (funcall constant b)))
                    (lambda (k) (put k (if (zerop k) (ball-sum (at a 0) number) (at a k))))))
          (:scale (let ((a (series a)) (number (funcall constant b)))
                    (lambda (k) (put k (ball-product (at a k) number)))))
          (:over (let ((a (series a)) (number (ball-inverse (funcall constant b))))
                   (lambda (k) (put k (ball-product (at a k) number)))))
          (:fixed (let ((number (funcall constant a))) (lambda (k) (put k (if (zerop k) number (ball 0 0))))))
          (:multiply (let ((a (series a)) (b (series b)))
                       (lambda (k)
                         (put k (if (zerop k) (ball-product (at a 0) (at b 0)) (ball-products a b k 0 k))))))
          (:square (let ((a (series a)))
                     (lambda (k) (put k (if (zerop k) (ball-square (at a 0)) (square-coefficient a k 0))))))
          (:divide (let ((a (series a)) (b (series b)))
                     (lambda (k)
                       (under k b (if (zerop k)
                                      (at a 0)
                                      (ball-difference (at a k) (ball-products b result k 1 k)))))))
          (:reciprocal (let ((a (series a)) (number (funcall constant b)))
                         (lambda (k)
                           (under k a (if (zerop k) number (ball-negative (ball-products a result k 1 k)))))))
          (:sqrt (let ((a (series a)))
                   (lambda (k)
                     (if (zerop k)
                         (first-value 0 :sqrt (at a 0))
                         (under k result
                                (ball-halved (ball-difference (at a k) (square-coefficient result k 1)) 1))))))
          (:power (power-advancer result (series a) (or (small-rational (funcall exact b)) (funcall constant b))))
          (:primitive (let ((b (series b)) (c (series c)))
                        (lambda (k)
                          (if (zerop k)
                              (first-value 0 a (at b 0))
                              (put k (signed-ball (ball-over (weighted-ball-products b c k 1 k) k) d))))))
          (:primitive-over
           (let ((b (series b)) (c (series c)))
             (lambda (k)
               (if (zerop k)
                   (first-value 0 a (at b 0))
                   (under k c (ball-over (ball-difference (ball-times (at b k) (* d k))
                                                          (weighted-ball-products result c k 1 (1- k)))
                                         k))))))
          (:angle
           (let ((a (series a)) (b (series b)) (c (series c)))
             (lambda (k)
               (if (zerop k)
                   (first-value 0 :atan2 (at a 0) (at b 0))
                   (under k c (ball-over (ball-difference (ball-difference (weighted-ball-products a b k 1 k)
                                                                           (weighted-ball-products b a k 1 k))
                                                          (weighted-ball-products result c k 1 (1- k)))
                                         k))))))
          ((:absolute :sign :floor :larger :smaller)
           (complain "rigorous = true has no enclosure of kinks such as those of abs and signum")))))))

(defun square-coefficient (a k from)
  "The sum of a[j] a[k-j], j = FROM .. k - FROM, k > 0."
  (let ((sum (ball-times (ball-products a a k from (floor (1- k) 2)) 2)))
    (if (oddp k) sum (ball-sum sum (ball-square (ball-coefficient a (/ k 2)))))))

(defun small-rational (number)
  "NUMBER, if it is one whose multiples are fixnums."
  (and number (< (abs (numerator number)) 1000000) (< (denominator number) 1000000) number))

(defun power-advancer (result a exponent)
  "y = a^c, c = p/q or a ball: y[k] = sum (p j - q (k-j)) a[j] y[k-j], j = 1 .. k, over k q a[0]."
  (let ((number (if (consp exponent) exponent (ball-of exponent))) (inverse nil))
    (flet ((sum (k)
             (if (consp exponent)
                 (ball-difference (ball-product number (weighted-ball-products a result k 1 k))
                                  (ball-difference (ball-times (ball-products a result k 1 k) k)
                                                   (weighted-ball-products a result k 1 k)))
                 (power-products a result k 1 k (numerator exponent) (denominator exponent))))
           (divisor (k) (if (consp exponent) k (* k (denominator exponent)))))
      (lambda (k)
        (cond ((zerop k) (put-coefficient result 0 (ball-power (ball-coefficient a 0) number)))
              (t (when (= k 1) (setq inverse (ball-inverse (ball-coefficient a 0))))
                 (put-coefficient result k (ball-product (ball-over (sum k) (divisor k)) inverse))))))))

;;; Programs

(defun varied-program (program n)
  "PROGRAM, with the derivatives of its results by the first N inputs as further results; and the places of these, pairs
of rows and columns."
  (multiple-value-bind (derived places) (differentiated-program program n)
    (values (make-program :instructions (program-instructions derived) :guards (program-guards program)
                          :results (append (program-results program) (program-results derived)))
            places)))

(defstruct (ball-field (:print-function print-dots))
  program                    ; SERIES-PROGRAM
  states order
  series                     ; vector: of states, time, instructions
  advancers                  ; of the instructions, functions (k)
  rates                      ; for each state a series or a ball
  derivatives                ; lists (row column series or ball)
  variations)                ; vector, by rows, of the series of the derivatives of states by first states; or nil

(defun new-ball-field (program n inputs order &key (places :none) thin)
  "Of a straight-line PROGRAM of N rates, and of the derivatives at PLACES (:none: there are none); of INPUTS, balls,
those of parameters are taken.  THIN: balls of states will be small."
  (multiple-value-bind (series-program operands) (series-program-of program n)
    (let* ((instructions (series-program-instructions series-program))
           (constants (constant-values series-program (ball-numbers) inputs))
           (exact (exact-constants series-program))
           (series (coerce (loop repeat (+ n 1 (length instructions)) collect (new-ball-series order thin)) 'vector)))
      (flet ((series (number) (svref series number))
             (constant (number) (aref constants number)))
        (flet ((operand (operand) (if (consp operand) (constant (cdr operand)) (series operand))))
          (make-ball-field
           :program series-program :states n :order order :series series
           :advancers (loop for instruction across instructions
                            for place from (1+ n)
                            collect (ball-advancer instruction (svref series place) #'series #'constant
                                                   (lambda (number) (aref exact number))))
           :rates (mapcar #'operand (subseq operands 0 n))
           :derivatives (loop for (row . column) in (if (listp places) places '())
                              for derivative in (nthcdr n operands)
                              collect (list row column (operand derivative)))
           :variations (and (listp places)
                            (coerce (loop repeat (* n n) collect (new-ball-series order thin)) 'vector))))))))

(defun operand-coefficient (operand k)
  (cond ((ball-series-p operand) (ball-coefficient operand k))
        ((zerop k) operand)
        (t (ball 0 0))))

(defun ball-in-steps (ball step k)
  "BALL times the rational number STEP over K."
  (let ((above (numerator step)))
    (ball-over (ball-times ball above) (* k (denominator step)))))

(defun expand-balls (field states time step order)
  "Find the coefficients up to ORDER at STATES and TIME, balls, in powers of the time by the rational number STEP."
  (let ((series (ball-field-series field)) (n (ball-field-states field)))
    (loop for i from 0 for state in states do (put-coefficient (svref series i) 0 state))
    (put-coefficient (svref series n) 0 time)
    (loop for k from 1 to order
          do (put-coefficient (svref series n) k (if (= k 1) (ball-of step) (ball 0 0))))
    (when (ball-field-variations field) (begin-variations field))
    (dotimes (k order)
      (advance-instructions field k)
      (loop for rate in (ball-field-rates field)
            for i from 0
            do (put-coefficient (svref series i) (1+ k) (ball-in-steps (operand-coefficient rate k) step (1+ k))))
      (when (ball-field-variations field) (advance-variations field k step)))))

(defun advance-instructions (field k)
  "Coefficient K of all."
  (let ((place 0))
    (handler-case (dolist (advance (ball-field-advancers field))
                    (funcall (the function advance) k)
                    (incf place))
      (domain-violation (condition)
        (let ((guard (cdr (assoc place (series-program-guards (ball-field-program field))))))
          (error 'domain-violation :operation (or (car guard) (violated-operation condition)) :source (cdr guard)))))))

(defun begin-variations (field)
  (let ((n (ball-field-states field)) (variations (ball-field-variations field)))
    (dotimes (i n)
      (dotimes (j n)
        (put-coefficient (svref variations (+ j (* i n))) 0 (if (= i j) (unit-ball) (ball 0 0)))))))

(defun advance-variations (field k step)
  "Coefficient K + 1 of the derivatives, by Y' = A Y."
  (let* ((n (ball-field-states field)) (variations (ball-field-variations field))
         (sums (make-array (* n n) :initial-element nil)))
    (loop for (row column factor) in (ball-field-derivatives field)
          do (dotimes (j n)
               (let ((term (variation-term factor (svref variations (+ j (* column n))) k)) (place (+ j (* row n))))
                 (when term
                   (setf (svref sums place) (if (svref sums place) (ball-sum (svref sums place) term) term))))))
    (dotimes (place (* n n))
      (put-coefficient (svref variations place) (1+ k)
                       (if (svref sums place) (ball-in-steps (svref sums place) step (1+ k)) (ball 0 0))))))

(defun variation-term (factor variation k)
  "Coefficient K of the product; nil if it is 0."
  (let ((term (if (ball-series-p factor)
                  (and (some-coefficient-p variation k) (ball-products factor variation k 0 k))
                  (let ((last (ball-coefficient variation k)))
                    (and (not (equal last '(0 . 0))) (ball-product factor last))))))
    term))

(defun some-coefficient-p (series k)
  "Whether one of the coefficients up to K is not 0."
  (let ((middles (ball-series-middles series)) (radii (ball-series-radii series)))
    (loop for j from 0 to k
          thereis (not (and (eql 0 (svref middles j)) (eql 0 (svref radii j)))))))

(defun state-coefficient (field i k) (ball-coefficient (svref (ball-field-series field) i) k))

(defun variation-coefficient (field i j k)
  (ball-coefficient (svref (ball-field-variations field) (+ j (* i (ball-field-states field)))) k))
