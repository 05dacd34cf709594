;;; anmech: is an expression zero?  First step: its value at random points.
;;;
;;; An expression is evaluated in complex double floats together with a bound of the rounding error; a value beyond its
;;; bound proves that the expression is not zero.  Undefined functions have values too: a number made from the name and
;;; the values of the arguments, so that f(a*b) and f(b*a) agree and nothing else does.
;;;
;;; Source: J. T. Schwartz, Fast probabilistic algorithms for verification of polynomial identities, J. ACM 27 (1980)
;;; 701.
;;;
;;; Identities of roots and logarithms are meant for positive symbols.  Whether one also holds for the other signs is
;;; told by real points alone, those where every root and logarithm is real; roots of odd degree are real there for
;;; negative numbers too, as Maxima has it.
;;;
;;; Entry points: anmech_numeric_zero, anmech_real_zero, anmech_of_solution, anmech_generic_rank; POINT-VALUE,
;;; *BOUND-VALUES*, UNKNOWN-FUNCTION-P.
;;; An operator that binds a symbol has a value of its own, the property point-value; so has what is linear in the
;;; solution of linear equations.

(in-package :anmech)
(needs "session/scope" "session/texts" "arithmetic/approximate" "algebra/kinks" "algebra/terms")

(defvar *seed* 0 "What the random values at the present point are made from.")
(defvar *bound-values* '() "An alist from symbols that an operator binds, as a sum does, to their present values.")
(defvar *signs* :positive "Symbols of unknown sign are :positive, :negative or :mixed at the present point.")

(defvar *real* nil "nil; :roots where roots of odd degree are real; :only where everything must be real, too.")
(defvar *spread* nil "Whether symbols of unknown sign are of different sizes at the present point.")

(defun scrambled (text)
  "A number in (0,1) made from TEXT and the seed, the same on every Lisp."
  (let ((state (+ 2166136261 (* 7919 *seed*))))
    (loop for character across text
          do (setq state (mod (* (logxor state (char-code character)) 16777619) 4294967296)))
    (loop repeat 3
          do (setq state (mod (+ (* state 1664525) 1013904223) 4294967296)))
    (/ (+ 0.5d0 state) 4294967296d0)))

(defun symbol-point (symbol)
  "The value of SYMBOL at the present point, of the sign that is known of it."
  (case (maxima::$csign symbol)
    ((maxima::$neg maxima::$nz) (- (size-of-value (symbol-name symbol))))
    ((maxima::$pos maxima::$pz) (size-of-value (symbol-name symbol)))
    (t (car (named-value (symbol-name symbol))))))

(defun size-of-value (name)
  (* (+ 0.3d0 (* 1.4d0 (scrambled name)))
     (if *spread*
         (nth (floor (* 4 (scrambled (concatenate 'string "size of " name)))) '(0.1d0 1d0 1d0 6d0))
         1d0)))

(defun named-value (name)
  "The number that a variable of this name and of unknown sign is at the present point."
  (cons (if (ecase *signs*
              (:positive nil)
              (:negative t)
              (:mixed (< (scrambled (concatenate 'string "sign of " name)) 0.5d0)))
            (- (size-of-value name))
            (size-of-value name))
        0d0))

(defun error-function (z)
  "2/sqrt(pi) z exp(-z^2) (1 + 2 z^2/3 + (2 z^2)^2/(3 5) + ..), near the origin; far from it rounding would count."
  (when (> (abs z) 4) (undecided))
  (let ((term 1d0) (sum 1d0))
    (loop for n from 1 below 120
          do (setq term (/ (* term 2 z z) (+ (* 2 n) 1))
                   sum (+ sum term)))
    (* (/ 2 (sqrt pi)) z (exp (- (* z z))) sum)))

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
    (maxima::%acosh ,#'acosh ,(lambda (z f) (declare (ignore f)) (/ 1 (sqrt (abs (- (* z z) 1))))))
    (maxima::%atanh ,#'atanh ,(lambda (z f) (declare (ignore f)) (/ 1 (abs (- 1 (* z z))))))
    (maxima::%erf ,#'error-function ,(lambda (z f) (declare (ignore f)) (* 1.2d0 (abs (exp (- (* z z)))))))
    (maxima::mabs ,(lambda (z) (abs z)) ,(lambda (z f) (declare (ignore z f)) 1d0))
    (maxima::%signum ,(lambda (z) (if (complexp z) (undecided) (signum z)))
     ,(lambda (z f) (declare (ignore z f)) 0d0)))
  "Functions with a bound of their derivative's size at z, f being the value there.")

(defun reciprocal-function (operator)
  (cdr (assoc operator '((maxima::%sec . maxima::%cos) (maxima::%csc . maxima::%sin) (maxima::%cot . maxima::%tan)
                         (maxima::%sech . maxima::%cosh) (maxima::%csch . maxima::%sinh)
                         (maxima::%coth . maxima::%tanh)))))

(defun point-value (form)
  "FORM at the present point, as (value . bound)."
  (cond ((numberp form) (approximate (coerce form 'double-float) 0d0))
        ((eq form 'maxima::$%pi) (approximate pi 0d0))
        ((eq form 'maxima::$%e) (approximate (exp 1d0) 0d0))
        ((eq form 'maxima::$%phi) (approximate (/ (+ 1 (sqrt 5d0)) 2) 0d0))
        ((eq form 'maxima::$%i) (cons #c(0d0 1d0) 0d0))
        ((member form '(maxima::$inf maxima::$minf maxima::$infinity maxima::$und maxima::$ind nil t)) (undecided))
        ((symbolp form) (or (cdr (assoc form *bound-values*)) (cons (symbol-point form) 0d0)))
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
  (let ((value (point-value base)))
    (cond ((integerp exponent) (raise-approximate value exponent))
          ((and *real* (realp (real-if-real (car value))) (minusp (realpart (car value))))
           (negative-power (cons (realpart (car value)) (cdr value)) exponent))
          (t (raise-approximate value (point-value exponent))))))

(defun negative-power (value exponent)
  "A power of a negative number that is no whole one: the real one, if there is one."
  (cond ((and (operator-p exponent 'maxima::rat) (oddp (third exponent)))
         (let ((size (raise-approximate (cons (- (car value)) (cdr value)) (point-value exponent))))
           (if (oddp (second exponent)) (cons (- (car size)) (cdr size)) size)))
        ((eq *real* :only) (undecided))
        (t (raise-approximate value (point-value exponent)))))

(defun function-value (operator form)
  (let ((known (assoc operator *derivative-bounds*))
        (reciprocal (reciprocal-function operator)))
    (cond (known (destructuring-bind (function bound) (rest known)
                   (let* ((argument (point-value (second form)))
                          (z (real-if-real (car argument)))
                          (value (real-if-real (funcall function z))))
                     (when (member operator '(maxima::%log maxima::%asin maxima::%acos maxima::%acosh maxima::%atanh))
                       (refuse-jump argument))
                     (when (and (eq *real* :only) (realp z) (complexp value)) (undecided))
                     (when (eq operator 'maxima::%signum) (unless (certainly-nonzero-p argument) (undecided)))
                     (approximate value (* (+ (cdr argument) (* +unit+ (abs z)))
                                           (abs (funcall bound z value)))))))
          (reciprocal (raise-approximate (function-value reciprocal form) -1))
          ((member 'maxima::array (first form)) (named-value (plain-name form)))
          ((eq operator 'maxima::%derivative) (unknown-derivative form))
          ((get operator 'point-value) (funcall (get operator 'point-value) form))
          ((member operator '(maxima::%atan2 maxima::$atan2)) (apply #'angle-value (mapcar #'point-value (rest form))))
          ((unknown-function-p form)
           (unknown-value (symbol-name operator) (mapcar #'point-value (rest form))
                          (mapcar (constantly 0) (rest form))))
          (t (undecided)))))

(dolist (operator *written-by-signs*)
  (setf (get operator 'point-value)
        (lambda (form)
          (let ((signs (by-signs form)))
            (if (eq signs form) (undecided) (point-value signs))))))

(defun angle-value (y x)
  (when (or (complexp (car x)) (complexp (car y)) (and (minusp (car x)) (not (certainly-nonzero-p y))))
    (undecided))
  (approximate (atan (car y) (car x))
               (/ (+ (* (abs (car x)) (cdr y)) (* (abs (car y)) (cdr x))) (+ (expt (car x) 2) (expt (car y) 2)))))

;;; An undefined function is a function like any other: a constant and two waves, their numbers made from its name.  So
;;; it has derivatives, and rounding errors of its arguments do to it what they do to other functions.

(defun unknown-value (name arguments orders)
  "The derivative of ORDERS, one for each place, of the undefined function NAME at ARGUMENTS, approximate numbers."
  (flet ((number-for (what place)
           (cons (+ 0.2d0 (scrambled (format nil "~a ~a ~d" name what place))) 0d0))
         (wave (angle quarters)
           (let ((turned (+ (car angle) (* quarters (/ pi 2)))))
             (approximate (sin turned) (* (+ (cdr angle) (* +unit+ (abs turned))) (cosh (imagpart turned)))))))
    (let ((value (cons (if (every #'zerop orders) 2d0 0d0) 0d0)) (place 0))
      (dotimes (term 2 value)
        (let ((angle (number-for "phase" term)) (factor (cons 0.7d0 0d0)))
          (loop for argument in arguments
                for order in orders
                for frequency = (number-for "frequency" (incf place))
                do (setq angle (add-approximate angle (multiply-approximate frequency argument)))
                   (loop repeat order do (setq factor (multiply-approximate factor frequency))))
          (setq value (add-approximate value (multiply-approximate
                                              factor (wave angle (reduce #'+ orders))))))))))

(defun unknown-function-p (form)
  (let ((operator (and (consp form) (caar form))))
    (and operator (symbolp operator)
         (char= (char (symbol-name operator) 0) #\$)
         (not (fboundp operator))
         (not (get operator 'maxima::operators)))))        ; a simplifier of Maxima's, such as that of max

(defun unknown-derivative (form)
  "A derivative of an undefined function by its arguments, or by what one of them is made of (first order)."
  (destructuring-bind (function . steps) (rest form)
    (cond ((symbolp function) (named-value (plain-name form)))
          ((not (unknown-function-p function)) (undecided))
          (t (let* ((arguments (rest function))
                    (values (mapcar #'point-value arguments))
                    (orders (make-list (length arguments) :initial-element 0)))
               (loop for (variable order) on steps by #'cddr
                     for place = (place-of variable arguments)
                     do (cond (place (incf (nth place orders) order))
                              ((equal (rest steps) '(1))
                               (return-from unknown-derivative (chain-rule function variable values)))
                              (t (undecided))))
               (unknown-value (symbol-name (caar function)) values orders))))))

(defun place-of (variable arguments)
  "The place of VARIABLE among ARGUMENTS if it occurs in no other."
  (let ((place (position variable arguments :test #'maxima::alike1)))
    (and place
         (loop for argument in arguments
               for k from 0
               always (or (= k place) (maxima::$freeof variable argument)))
         place)))

(defun chain-rule (function variable values)
  (let ((sum (cons 0d0 0d0)) (count (length values)))
    (dotimes (place count sum)
      (setq sum (add-approximate
                 sum
                 (multiply-approximate
                  (unknown-value (symbol-name (caar function)) values
                                 (loop for k below count collect (if (= k place) 1 0)))
                  (point-value (maxima::sdiff (nth place (rest function)) variable))))))))

(defun value-at-point (form)
  "(value . bound), or :undecided where FORM has no value in double floats."
  (catch 'undecided
    (handler-case
        (let ((approximate (point-value form)))
          (if (and (= (car approximate) (car approximate))
                   (< (abs (car approximate)) 1d250)
                   (< (cdr approximate) 1d250))
              approximate
              :undecided))
      (error () :undecided))))

(defun numeric-zero (form &key (points 4) (like form))
  "nil if FORM is certainly not zero; t if it is zero within rounding at several points; :undecided else.
Where LIKE has roots or logarithms, the points are those where all unknown signs are positive."
  (let ((seen 0) (branched (branched-p like)))
    (dotimes (k (* 2 points) (if (plusp seen) (beyond-rounding form) :undecided))
      (let* ((*seed* k)
             (*signs* (cond ((or branched (= k 0)) :positive) ((= k 1) :negative) (t :mixed)))
             (value (value-at-point form)))
        (unless (eq value :undecided)
          (when (certainly-nonzero-p value) (return nil))
          (when (and (precise-p value) (= (incf seen) points)) (return (beyond-rounding form))))))))

(maxima::defmfun maxima::$anmech_numeric_zero (form &optional (like form) (points 4))
  "anmech_numeric_zero(expr, [like, points]): false = certainly not zero; true = zero at several points; unknown."
  (let ((answer (numeric-zero form :like like :points points)))
    (if (eq answer :undecided) 'maxima::$unknown answer)))

;;; Zero within rounding is no sign of zero where a number is too small for doubles.  A rational function is then
;;; evaluated modulo a prime; of others nothing is said.

(defconstant +large-prime+ (1- (expt 2 61)))
(defconstant +extreme-number+ (expt 10 60))

(defun rational-form-p (form)
  "Whether FORM is a rational function of symbols with rational coefficients."
  (cond ((integerp form) t)
        ((symbolp form) (not (or (null form) (eq form t) (maxima::$constantp form))))
        ((atom form) nil)
        (t (case (caar form)
             (maxima::rat t)
             ((maxima::mplus maxima::mtimes) (every #'rational-form-p (rest form)))
             (maxima::mexpt (and (integerp (third form)) (rational-form-p (second form))))))))

(defun has-extreme-number-p (form)
  (cond ((integerp form) (> (abs form) +extreme-number+))
        ((atom form) nil)
        (t (some #'has-extreme-number-p (rest form)))))

(defun large-residue (form)
  "The value of a rational function at the present point, modulo a prime."
  (flet ((power (base exponent)
           (let ((result 1))
             (loop while (plusp exponent)
                   do (when (oddp exponent) (setq result (mod (* result base) +large-prime+)))
                      (setq base (mod (* base base) +large-prime+)
                            exponent (ash exponent -1)))
             result)))
    (flet ((inverse (residue)
             (when (zerop residue) (undecided))
             (power residue (- +large-prime+ 2))))
      (cond ((integerp form) (mod form +large-prime+))
            ((symbolp form) (1+ (floor (* (scrambled (symbol-name form)) 4294967296d0))))
            (t (case (caar form)
                 (maxima::rat (mod (* (mod (second form) +large-prime+) (inverse (mod (third form) +large-prime+)))
                                   +large-prime+))
                 (maxima::mplus (mod (reduce #'+ (mapcar #'large-residue (rest form))) +large-prime+))
                 (maxima::mtimes (reduce (lambda (a b) (mod (* a b) +large-prime+))
                                         (mapcar #'large-residue (rest form))))
                 (t (let ((base (large-residue (second form))) (exponent (third form)))
                      (if (minusp exponent) (inverse (power base (- exponent))) (power base exponent))))))))))

(defun beyond-rounding (form)
  "What is to be said of FORM where its values are zero within rounding: t, nil or :undecided."
  (cond ((rational-form-p form)
         (if (loop for *seed* below 4
                   thereis (let ((residue (catch 'undecided (large-residue form))))
                             (and (integerp residue) (plusp residue))))
             nil
             t))
        ((has-extreme-number-p form) :undecided)
        (t t)))

;;; Real points of all signs

(defparameter *most-real-points* 12)

(defun real-zero (form spread like)
  "nil if FORM is certainly not zero at some real point; t if it is zero at several; :undecided else."
  (if (nonzero-beyond-kinks-p form like) nil (zero-at-real-points form spread like)))

(defun value-where-real (form like)
  "The value of FORM at the present point if this is real, or LIKE is there."
  (cond ((null like) (let ((*real* :only)) (value-at-point form)))
        ((real-here-p like) (let ((*real* :roots)) (value-at-point form)))
        (t :undecided)))

(defun zero-at-real-points (form spread like)
  (let ((seen 0) (*signs* :mixed))
    (dotimes (k (* 5 *most-real-points*) (if (> seen 3) (beyond-rounding form) :undecided))
      (let* ((*seed* (+ 1000 k))
             (*spread* (and spread (oddp k)))
             (value (value-where-real form like)))
        (unless (eq value :undecided)
          (when (certainly-nonzero-p value) (return nil))
          (when (and (precise-p value) (= (incf seen) *most-real-points*)) (return (beyond-rounding form))))))))

;;; A force that acts beyond a kink only, as max(0, x - 100) does, is zero at all points of a usual size: one symbol of
;;; a kink runs through the reals, the others stay, and FORM is evaluated between all zeros of the kinks that are met.

(defparameter *most-running* 6 "So many symbols of the kinks run, one after the other.")
(defparameter *places*
  (let ((sizes (loop for k from -12 to 36 collect (expt 10d0 (/ k 4)))))
    (append (reverse (mapcar #'- sizes)) '(0d0) sizes))
  "Where the signs of kinks are compared.")

(defun nonzero-beyond-kinks-p (form like)
  (let* ((kinks (kinks-of form)) (*signs* :mixed))
    (and kinks
         (loop for symbol in (first-of (running-symbols kinks) *most-running*)
               thereis (loop for *seed* from 2000 to 2001
                             thereis (some (lambda (value)
                                             (let ((*bound-values* (acons symbol (cons value 0d0) *bound-values*)))
                                               (let ((found (value-where-real form like)))
                                                 (and (consp found) (certainly-nonzero-p found)))))
                                           (values-between (zeros-along symbol kinks) (sign-along symbol))))))))

(defun running-symbols (kinks)
  (remove-if #'maxima::$constantp (remove-duplicates (mapcan #'symbols-in kinks) :from-end t)))

(defun first-of (list count) (subseq list 0 (min count (length list))))

(defun sign-along (symbol)
  (case (maxima::$csign symbol)
    ((maxima::$neg maxima::$nz) -1)
    ((maxima::$pos maxima::$pz) 1)
    (t nil)))

(defun zeros-along (symbol forms)
  "Where some of FORMS change their signs while SYMBOL runs, the others being what they are at the present point."
  (loop for form in forms
        append (flet ((side (value)
                        (let* ((*bound-values* (acons symbol (cons value 0d0) *bound-values*))
                               (found (let ((*real* :only)) (value-at-point form))))
                          (and (consp found) (realp (real-if-real (car found))) (signum (realpart (car found)))))))
                 (loop for (a b) on *places*
                       for last = (side a) then here
                       for here = (and b (side b))
                       when (and last here (/= last here))
                         collect (bisected #'side a b last)))))

(defun bisected (side a b sign)
  (loop repeat 60
        do (let ((middle (/ (+ a b) 2)))
             (if (eql (funcall side middle) sign) (setq a middle) (setq b middle))))
  (/ (+ a b) 2))

(defun values-between (zeros sign)
  "Values between neighbours of ZEROS and outside of them all; of the SIGN, if it is not nil."
  (when zeros
    (let* ((ordered (sort (copy-list zeros) #'<))
           (low (first ordered))
           (high (first (last ordered))))
      (remove-if (lambda (value) (and sign (minusp (* sign value))))
                 (append (list (- low 1 (/ (abs low) 8)) (+ high 1 (/ (abs high) 8)))
                         (loop for (a b) on ordered
                               when (and b (> (- b a) (* 1d-9 (+ (abs a) (abs b))))) collect (/ (+ a b) 2)))))))

(defun real-here-p (form)
  (let ((value (let ((*real* :only)) (value-at-point form))))
    (and (not (eq value :undecided)) (realp (car (almost-real value))))))

(maxima::defmfun maxima::$anmech_real_zero (form &optional (spread t) (like nil))
  "anmech_real_zero(expr, [spread, like]): false = certainly not zero at a real point, symbols of unknown sign taking
both signs (and different sizes, if spread is true); true = zero at several real points; unknown.  A point is real where
everything in expr is, or the value of like."
  (let ((answer (real-zero form spread like)))
    (if (eq answer :undecided) 'maxima::$unknown answer)))

;;; Rank at random points: the generic one, with certainty from below

(defun numeric-rank (rows)
  "Rank of ROWS, a list of vectors of approximate numbers, by elimination; pivots are certainly not zero."
  (let ((rank 0))
    (loop
      (let ((largest 0d0) (best nil) (column 0))
        (dolist (row rows)
          (dotimes (j (length row))
            (let ((entry (aref row j)))
              (when (and (> (abs (car entry)) largest) (certainly-nonzero-p entry))
                (setq largest (abs (car entry)) best row column j)))))
        (unless best (return rank))
        (incf rank)
        (setq rows (mapcar (lambda (row) (row-without row best column)) (remove best rows)))))))

(defun row-without (row pivot-row column)
  (let ((factor (multiply-approximate (cons -1d0 0d0)
                                      (multiply-approximate (aref row column)
                                                            (raise-approximate (aref pivot-row column) -1)))))
    (coerce (loop for entry across row
                  for pivot across pivot-row
                  for j from 0
                  collect (if (= j column) (cons 0d0 0d0) (add-approximate entry (multiply-approximate factor pivot))))
            'vector)))

(defun rank-at-point (rows)
  (let ((values (mapcar (lambda (row) (mapcar #'value-at-point row)) rows)))
    (if (some (lambda (row) (member :undecided row)) values)
        nil
        (numeric-rank (mapcar (lambda (row) (coerce (scaled-row row) 'vector)) values)))))

(defun scaled-row (row)
  "ROW with entries of the order of 1: a decaying factor such as exp(-500 t) must not overflow in the elimination."
  (let ((largest (loop for (value) in row maximize (abs value))))
    (if (< 1d-290 largest 1d290)
        (mapcar (lambda (entry) (multiply-approximate entry (cons (/ largest) 0d0))) row)
        row)))

(maxima::defmfun maxima::$anmech_generic_rank (matrix)
  "anmech_generic_rank(matrix): rank at generic values of everything in it, or unknown."
  (let* ((rows (mapcar #'rest (rest matrix)))
         (ranks (loop for seed below 4 collect (let ((*seed* seed)) (rank-at-point rows)))))
    (if (every #'null ranks) 'maxima::$unknown (reduce #'max (remove nil ranks)))))

;;; What is linear in the solution of linear equations, without solving them

(defun point-values (list) (mapcar #'point-value (rest list)))

(defun bordered-rows (matrix right)
  (mapcar (lambda (row entry) (append (point-values row) (list (point-value entry)))) (rest matrix) (rest right)))

(defun approximate-product (x y)
  (reduce #'add-approximate (mapcar #'multiply-approximate x y) :initial-value (cons 0d0 0d0)))

(defun solved-value (form)
  "The value of anmech_of_solution(..) at the present point."
  (destructuring-bind (given coefficients matrix right variables residuals jacobian) (rest form)
    (let ((*bound-values* (append (values-on-surface variables residuals jacobian) *bound-values*)))
      (add-approximate (point-value given)
                       (approximate-product (point-values coefficients)
                                            (approximate-solution (bordered-rows matrix right)))))))

(defun values-on-surface (variables residuals jacobian)
  "An alist from VARIABLES to the values nearest to those of the present point where RESIDUALS vanish."
  (when (rest residuals)
    (let* ((rows (mapcar #'point-values (rest jacobian)))
           (shift (approximate-solution
                   (mapcar (lambda (row residual)
                             (append (mapcar (lambda (other) (approximate-product row other)) rows)
                                     (list (point-value residual))))
                           rows (rest residuals)))))
      (loop for variable in (rest variables)
            for k from 0
            collect (cons variable
                          (add-approximate
                           (point-value variable)
                           (multiply-approximate
                            (cons -1d0 0d0)
                            (approximate-product (mapcar (lambda (row) (nth k row)) rows) shift))))))))

(defun approximate-solution (rows)
  "The list u with A u = b for ROWS, lists of approximate numbers [A | b]."
  (let* ((n (length rows)) (used '()) (left (mapcar (lambda (row) (coerce (scaled-row row) 'vector)) rows)))
    (dotimes (column n)
      (let ((best (loop with largest = 0d0 and found = nil
                        for row in left
                        for size = (abs (car (aref row column)))
                        do (when (and (> size largest) (certainly-nonzero-p (aref row column)))
                             (setq largest size found row))
                        finally (return (or found (undecided))))))
        (setq left (mapcar (lambda (row) (row-without row best column)) (remove best left :test #'eq)))
        (push best used)))
    (let ((values (make-array n :initial-element (cons 0d0 0d0))))
      (loop for row in used
            for column downfrom (1- n)
            do (let ((sum (aref row n)))
                 (loop for k from (1+ column) below n
                       do (setq sum (add-approximate sum (multiply-approximate
                                                          (cons -1d0 0d0)
                                                          (multiply-approximate (aref row k) (aref values k))))))
                 (setf (aref values column) (multiply-approximate sum (raise-approximate (aref row column) -1)))))
      (coerce values 'list))))

(maxima::defmfun maxima::$anmech_of_solution (given coefficients matrix right variables residuals jacobian)
  "anmech_of_solution(g, c, A, b, v, f, W): g + c.u for A u = b, not solved; only its values at points are asked for.
Where there are f, those of v are moved by W^T y so that these vanish; they are linear in v with the coefficients W."
  (list '(maxima::|$of_solution`| maxima::simp) given coefficients matrix right variables residuals jacobian))

(setf (get 'maxima::|$of_solution`| 'point-value) #'solved-value)
