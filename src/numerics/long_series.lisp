;;; anmech: power series of many digits, whose coefficients are found one after the other.
;;;
;;; A *long series* has integers for coefficients, in units of one power of two: of a product of two of them a
;;; coefficient is a sum of products of integers, shortened once.  The unit is chosen when the first coefficient is
;;; known, such that this has *LONG-BITS* bits; where something has cancelled it has fewer, and nobody takes what is
;;; not known for digits.  Coefficients that are larger than the first just have more bits.  Series are in powers of
;;; s/2^SHIFT, s the time since the beginning of the step and 2^SHIFT about the step, so that coefficients fade: the
;;; later ones are short integers, and cheap.
;;;
;;; Entry points: *LONG-BITS*; the structure LONG-SERIES; NEW-LONG-SERIES, LONG-CONSTANT, BEGIN-IN-UNITS,
;;; FIRST-RATIONAL, COEFFICIENT, PRODUCTS, UNIT-FOR, INTEGER-IN-UNITS, IN-UNITS, ADVANCER.
;;;
;;; Literature: R. E. Moore, Interval Analysis (1966), chapter 11; A. Griewank, A. Walther, Evaluating Derivatives, 2nd
;;; ed. 2008, chapter 13.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/long_numbers")

(defvar *long-bits* 0 "How many bits are kept.")

(defstruct (long-series (:print-function print-long-series))
  (coefficients #(0) :type simple-vector)
  (exponent 0 :type fixnum)                   ; the unit is two to this power
  (slopes nil)                                ; where they are asked for: each coefficient times its order
  (constant nil))                             ; of a number: it, a rational; then there is one coefficient

(defun print-long-series (series stream depth)
  (declare (ignore depth))
  (format stream "#<series ~a>" (float (first-rational series))))

(defun new-long-series (order)
  (make-long-series :coefficients (make-array (1+ order) :initial-element 0)))

(defun long-constant (number)
  (let ((series (make-long-series :coefficients (vector 0) :constant number)))
    (begin-near series number (unit-for number))
    series))

;;; Integers and units

(defun unit-for (number)
  "The exponent of the units in which the rational NUMBER has *LONG-BITS* bits."
  (if (zerop number)
      (- *long-bits*)
      (- (integer-length (numerator number)) (integer-length (denominator number)) *long-bits*)))

(defun integer-in-units (number exponent)
  (if (minusp exponent)
      (floor (ash (numerator number) (- exponent)) (denominator number))
      (floor (numerator number) (ash (denominator number) exponent))))

(defun in-units (integer exponent)
  "The rational number."
  (if (minusp exponent) (/ integer (ash 1 (- exponent))) (ash integer exponent)))

(declaim (inline coefficient))
(defun coefficient (series k)
  (declare (fixnum k))
  (let ((coefficients (long-series-coefficients series)))
    (if (< k (length coefficients)) (svref coefficients k) 0)))

(defun first-rational (series)
  (or (long-series-constant series) (in-units (coefficient series 0) (long-series-exponent series))))

(defun begin-with (series exponent coefficient)
  (setf (long-series-exponent series) exponent
        (svref (long-series-coefficients series) 0) coefficient))

(defun begin-in-units (series number exponent)
  "Begin SERIES with the rational NUMBER."
  (begin-with series exponent (integer-in-units number exponent)))

(defun begin-near (series number least)
  "The same in units that give *LONG-BITS* bits, but not in smaller ones than LEAST."
  (begin-in-units series number (if (zerop number) least (max least (unit-for number)))))

(defun long-value (operation &rest numbers)
  (or (apply #'long-operation operation *long-bits* numbers)
      (error 'domain-violation :operation operation :source nil)))

(defun long-divisor (integer)
  (if (eql integer 0) (error 'domain-violation :operation :divide :source nil) integer))

;;; Sums of products

(defparameter *short* 1048576 "Products with numbers of such small parts are not shortened.")

(defmacro define-sum (name arguments documentation &key from to term)
  "A function of two vectors a and b and of ARGUMENTS: the sum over j of TERM, with i = k - j; terms where a[j] is 0 are
passed over."
  `(defun ,name (a b k ,@arguments)
     ,documentation
     (declare (simple-vector a b) (fixnum k ,@arguments) (optimize (speed 3) (safety 0)))
     (let ((sum 0) (end ,to))
       (declare (fixnum end))
       (do ((j ,from (the fixnum (1+ j)))
            (i (the fixnum (- k (the fixnum ,from))) (the fixnum (1- i))))
           ((> j end) sum)
         (declare (fixnum j i))
         (let ((factor (svref a j)))
           (unless (eql factor 0) (setq sum (+ sum ,term))))))))

(define-sum products (from) "The sum of a[j] b[k-j], j = FROM .. k." :from from :to k :term (* factor (svref b i)))

(define-sum weighted-products (to) "The sum of j a[j] b[k-j], j = 1 .. TO."
  :from 1 :to to :term (* j (* factor (svref b i))))

(define-sum products-of-power (above below)
  "The sum of (ABOVE j - BELOW (k-j)) a[j] b[k-j], j = 1 .. k, of small ABOVE and BELOW."
  :from 1 :to k
  :term (* (the fixnum (- (the fixnum (* above j)) (the fixnum (* below i)))) (* factor (svref b i))))

(defun slopes-of (series)
  "The vector of its coefficients times their orders, filled in by who needs them."
  (or (long-series-slopes series)
      (setf (long-series-slopes series)
            (make-array (length (long-series-coefficients series)) :initial-element 0))))

(defun squares (a k from)
  "The sum of a[j] a[k-j], j = FROM .. k - FROM."
  (declare (simple-vector a) (fixnum k from) (optimize (speed 3) (safety 0)))
  (let ((sum 0))
    (do ((j from (the fixnum (1+ j)))
         (i (the fixnum (- k from)) (the fixnum (1- i))))
        ((>= j i)
         (setq sum (ash sum 1))
         (if (= i j) (+ sum (* (svref a i) (svref a i))) sum))
      (declare (fixnum j i))
      (setq sum (+ sum (* (svref a j) (svref a i)))))))

;;; Recurrences: of every instruction (series_program.lisp) the coefficient of order k, where those of the operands up
;;; to k are known, and of the result before k

(defmacro define-recurrence (name (result &rest series) plain documentation &key first later)
  "A function of RESULT and SERIES, long series, of PLAIN, and of k.  FIRST begins the result; LATER, where the names
are those of vectors of coefficients and (unit NAME) is an exponent, gives its coefficient of order k, an integer."
  (let ((wholes (loop for name in (cons result series) collect (cons name (gensym (symbol-name name))))))
    `(defun ,name (,result ,@series ,@plain k)
       ,documentation
       (declare (fixnum k) (ignorable ,@plain))
       (if (zerop k)
           ,first
           (let ,(loop for (name . whole) in wholes collect (list whole name))
             (macrolet ((unit (name) (list 'long-series-exponent (cdr (assoc name ',wholes)))))
               (let ,(loop for (name . whole) in wholes collect `(,name (long-series-coefficients ,whole)))
                 (declare (simple-vector ,result ,@series) (ignorable ,@series))
                 (setf (svref ,result k) ,later))))))))

(defun begin-product (product a b)
  "In units in which it has as many bits as the factor that has fewer of them: otherwise a hundredth power of what has
one bit less than *LONG-BITS* would lack a hundred, and each square twice what its root lacks."
  (let* ((first (coefficient a 0)) (second (coefficient b 0))
         (bits (if (and (eql 0 first) (eql 0 second))
                   *long-bits*
                   (max (integer-length first) (integer-length second)))))
    (begin-with product (+ (long-series-exponent a) (long-series-exponent b) bits) (ash (* first second) (- bits)))))

(define-recurrence advance-product (r a b) ()
  "r = a b."
  :first (begin-product r a b)
  :later (ash (products a b k 0) (- (+ (unit a) (unit b)) (unit r))))

(define-recurrence advance-square (r a) ()
  "r = a^2."
  :first (begin-product r a a)
  :later (ash (squares a k 0) (- (* 2 (unit a)) (unit r))))

(define-recurrence advance-quotient (r a b) ()
  "r = a/b."
  :first (begin-with r (- (long-series-exponent a) (long-series-exponent b) *long-bits*)
                     (floor (ash (coefficient a 0) *long-bits*) (long-divisor (coefficient b 0))))
  :later (floor (- (ash (svref a k) *long-bits*) (products b r k 1)) (svref b 0)))

(define-recurrence advance-reciprocal (r b) (number)
  "r = NUMBER/b."
  :first (begin-with r (- (long-series-exponent number) (long-series-exponent b) *long-bits*)
                     (floor (ash (coefficient number 0) *long-bits*) (long-divisor (coefficient b 0))))
  :later (floor (- (products b r k 1)) (svref b 0)))

(define-recurrence advance-root (r a) ()
  "r = sqrt(a)."
  :first (let* ((square (coefficient a 0)) (shift (+ *long-bits* (mod (+ *long-bits* (long-series-exponent a)) 2))))
           (unless (plusp square) (error 'domain-violation :operation :sqrt :source nil))
           (begin-with r (/ (- (long-series-exponent a) shift) 2) (isqrt (ash square shift))))
  :later (floor (- (ash (svref a k) (- (unit a) (* 2 (unit r)))) (squares r k 1)) (* 2 (svref r 0))))

(define-recurrence advance-power (r a) (exponent)
  "r = a^EXPONENT, a rational number."
  :first (let ((value (long-value :expt (first-rational a) exponent)))
           (begin-near r value (unit-for value)))
  :later (let ((above (numerator exponent)) (below (denominator exponent)))
           (floor (if (and (< (abs above) *short*) (< below *short*))
                      (products-of-power a r k above below)
                      (- (* above (weighted-products a r k k)) (* below (weighted-products r a k (1- k)))))
                  (* k below (long-divisor (svref a 0))))))

(define-recurrence advance-primitive (r a q) (name sign slopes)
  "r, the function NAME of a, whose SLOPES are a vector, where r' = SIGN q a'; q may begin after r."
  :first (begin-function r a name)
  :later (progn (setf (svref slopes k) (* k (svref a k)))
                (floor (* sign (ash (products slopes q k 1) (- (+ (unit a) (unit q)) (unit r)))) k)))

(define-recurrence advance-primitive-over (r a d) (name sign)
  "r, the function NAME of a, where r' d = SIGN a'."
  :first (begin-function r a name)
  :later (floor (- (ash (* sign k (svref a k)) (- (unit a) (unit d) (unit r))) (weighted-products r d k (1- k)))
                (* k (long-divisor (svref d 0)))))

(define-recurrence advance-angle (r y x d) ()
  "r = atan2(y, x), where r' d = y' x - x' y."
  :first (begin-near r (long-value :atan2 (first-rational y) (first-rational x)) (- *long-bits*))
  :later (floor (- (ash (- (weighted-products y x k k) (weighted-products x y k k))
                        (- (+ (unit x) (unit y)) (unit d) (unit r)))
                   (weighted-products r d k (1- k)))
                (* k (long-divisor (svref d 0)))))

(defun begin-function (series argument name)
  "What is small where its argument is small keeps the units of that."
  (let ((value (long-value name (first-rational argument))))
    (begin-near series value
                (case name
                  ((:exp :erfc) (if (zerop value) (- *most-binary*) (unit-for value)))     ; it vanishes with its slopes
                  ((:sin :tan :asin :atan :sinh :tanh :asinh :atanh :erf)
                   (min (- *long-bits*) (long-series-exponent argument)))
                  (t (- *long-bits*))))))

(defun advance-sum (r a b sign k)
  "r = a + b, or with SIGN -1 the difference; one may be a number."
  (declare (fixnum k))
  (when (zerop k)
    (setf (long-series-exponent r) (max (long-series-exponent a) (long-series-exponent b))))
  (flet ((part (series)
           (ash (coefficient series k) (- (long-series-exponent series) (long-series-exponent r)))))
    (setf (svref (long-series-coefficients r) k)
          (if (plusp sign) (+ (part a) (part b)) (- (part a) (part b))))))

(defun advance-multiple (r a number k)
  "r = a times a number."
  (declare (fixnum k))
  (let ((exact (long-series-constant number)))
    (multiple-value-bind (exponent integer)
        (if (and (< (abs (numerator exact)) *short*) (< (denominator exact) *short*))
            (values (long-series-exponent a)
                    (values (floor (* (numerator exact) (coefficient a k)) (denominator exact))))
            (values (+ (long-series-exponent a) (long-series-exponent number) *long-bits*)
                    (ash (* (coefficient number 0) (coefficient a k)) (- *long-bits*))))
      (when (zerop k) (setf (long-series-exponent r) exponent))
      (setf (svref (long-series-coefficients r) k) integer))))

(defun advance-fixed (r number k)
  (declare (fixnum k))
  (if (zerop k)
      (begin-with r (long-series-exponent number) (coefficient number 0))
      (setf (svref (long-series-coefficients r) k) 0)))

;;; Instructions

(defun advancer (instruction result series constant)
  "A function (k) that advances RESULT by INSTRUCTION.  SERIES, a function, gives the long series of a number of one,
CONSTANT that of the number of a constant."
  (declare (type function series constant))
  (destructuring-bind (operation a &optional b c d) instruction
    (flet ((series (number) (funcall series number)) (constant (number) (funcall constant number)))
      (macrolet ((advancing (function &rest arguments)
                   (let ((names (loop for nil in arguments collect (gensym))))
                     `(let ,(mapcar #'list names arguments)
                        (lambda (k) (,function result ,@names k))))))
        (let ((minus-one (long-constant -1)))
          (ecase operation
            (:add (advancing advance-sum (series a) (series b) 1))
            (:subtract (advancing advance-sum (series a) (series b) -1))
            (:negate (advancing advance-multiple (series a) minus-one))
            (:shift (advancing advance-sum (series a) (constant b) 1))
            (:scale (advancing advance-multiple (series a) (constant b)))
            (:over (let ((number (long-series-constant (constant b))))
                     (advancing advance-multiple (series a) (long-constant (/ (long-divisor number))))))
            (:fixed (advancing advance-fixed (constant a)))
            (:multiply (advancing advance-product (series a) (series b)))
            (:square (advancing advance-square (series a)))
            (:divide (advancing advance-quotient (series a) (series b)))
            (:reciprocal (advancing advance-reciprocal (series a) (constant b)))
            (:sqrt (advancing advance-root (series a)))
            (:power (advancing advance-power (series a) (long-series-constant (constant b))))
            (:primitive (advancing advance-primitive (series b) (series c) a d (slopes-of (series b))))
            (:primitive-over (advancing advance-primitive-over (series b) (series c) a d))
            (:angle (advancing advance-angle (series a) (series b) (series c)))))))))
