;;; anmech: linear equations solved by minors, without division.
;;;
;;; An entry is read as a polynomial in its kernels with positive and negative exponents: x, sqrt(x^2 + y^2), F(t), and
;;; exp(%i*u) and exp(u) for sines, hyperbolic sines and exponentials.  In these cos(u)^2 + sin(u)^2 = 1 and its
;;; like hold of themselves, so that no minor is longer than it must be; where minors of sines and cosines as kernels of
;;; their own swell, these stay short.  A kernel such as sqrt(x^2 + y^2) is not reduced: what is read is right,
;;; but zero may look like something else.
;;;
;;; All minors of [A | b] come of one pass over its rows: a set of columns, as bits, has the minor of the rows so far.
;;;
;;; A polynomial is a hash table from exponents, packed into one integer, to Lisp numbers, complex ones among them.
;;; What is read is real, so that conjugate terms make sines and cosines again.
;;;
;;; Entry point: anmech_wave_minors.
;;;
;;; Sources: D. E. Knuth, The Art of Computer Programming 2 (1997), 4.6.1 (polynomials in many variables); W. M.
;;; Gentleman, S. C. Johnson, ACM Trans. Math. Software 2 (1976) 232 (minors beside elimination for sparse matrices of
;;; polynomials).

(in-package :anmech)
(needs "session/outcomes" "session/patience" "session/scope" "algebra/terms")

(defconstant +exponent-unit+ 12 "Exponents are whole multiples of one over this.")
(defconstant +exponent-bits+ 18)
(defconstant +largest-power+ 100 "Whole powers above this are kernels of their own.")

(defstruct kernel
  "KIND: :power of FORM, :wave exp(%i FORM), or :growth exp(FORM)."
  kind form)

(defvar *kernels* nil "The kernels read so far, a vector; the place of a kernel is that of its exponent.")
(defvar *kernel-places* nil "Places by kind and plain key.")
(defvar *products-left* 0 "How many products of terms are made before it is given up.")

(defun give-up-minors (reason) (throw 'minors (maxima::$anmech_not_found reason)))

;;; Polynomials

(defun constant-polynomial (number)
  (let ((polynomial (make-hash-table)))
    (unless (eql number 0) (setf (gethash 0 polynomial) number))
    polynomial))

(defun add-term (key coefficient polynomial)
  (let ((sum (+ (gethash key polynomial 0) coefficient)))
    (if (eql sum 0) (remhash key polynomial) (setf (gethash key polynomial) sum))))

(defun add-polynomial (polynomial total)
  "Add POLYNOMIAL to TOTAL, which is changed."
  (maphash (lambda (key coefficient) (add-term key coefficient total)) polynomial)
  total)

(defun add-product (one two total &optional (factor 1))
  "Add FACTOR times the product of two polynomials to TOTAL, which is changed."
  (when (minusp (decf *products-left* (* (hash-table-count one) (hash-table-count two))))
    (give-up-minors 'maxima::$too_long))
  (poll)
  (maphash (lambda (key coefficient)
             (let ((coefficient (* factor coefficient)))
               (maphash (lambda (other-key other) (add-term (+ key other-key) (* coefficient other) total)) two)))
           one)
  total)

(defun laurent-product (one two) (add-product one two (make-hash-table)))

;;; Exponents

(defun exponent-key (place exponent)
  (ash exponent (* +exponent-bits+ place)))

(defun key-bias ()
  "Added to a key it makes all exponents positive, so that they can be read off."
  (loop for place below (length *kernels*)
        sum (exponent-key place (ash 1 (1- +exponent-bits+)))))

(defun exponent-at (place key bias)
  (- (ldb (byte +exponent-bits+ (* +exponent-bits+ place)) (+ key bias)) (ash 1 (1- +exponent-bits+))))

(defun key-exponents (key bias)
  "The exponents in KEY, one for each kernel."
  (loop for place below (length *kernels*) collect (exponent-at place key bias)))

(defun kernel-place (kind form)
  (let ((key (cons kind (plain-key form))))
    (or (gethash key *kernel-places*)
        (setf (gethash key *kernel-places*)
              (vector-push-extend (make-kernel :kind kind :form form) *kernels*)))))

(defun kernel-power (kind form exponent)
  "The polynomial of one term, EXPONENT in units; nil if that is no whole number of them."
  (let ((units (* +exponent-unit+ exponent)))
    (when (and (integerp units) (<= (abs exponent) +largest-power+))
      (let ((polynomial (make-hash-table)))
        (setf (gethash (exponent-key (kernel-place kind form) units) polynomial) 1)
        polynomial))))

;;; Reading

(defun rational-number (form)
  "A number of Maxima's as one of Lisp's, or nil."
  (cond ((integerp form) form)
        ((operator-p form 'maxima::rat) (/ (second form) (third form)))))

(defun read-polynomial (form)
  (let ((number (rational-number form)))
    (cond (number (constant-polynomial number))
          ((or (numberp form) (operator-p form 'maxima::bigfloat) (eq form 'maxima::$%i))
           (give-up-minors 'maxima::$inexact))
          ((atom form) (kernel-power :power form 1))
          (t (case (caar form)
               (maxima::mplus (let ((total (make-hash-table)))
                                (dolist (part (rest form) total) (add-polynomial (read-polynomial part) total))))
               (maxima::mtimes (reduce #'laurent-product (mapcar #'read-polynomial (rest form))))
               (maxima::mexpt (read-power form (second form) (third form)))
               (maxima::%sin (read-pair form :wave (/ #c(0 -1) 2) (/ #c(0 1) 2)))
               (maxima::%cos (read-pair form :wave 1/2 1/2))
               (maxima::%sinh (read-pair form :growth 1/2 -1/2))
               (maxima::%cosh (read-pair form :growth 1/2 1/2))
               (t (kernel-power :power form 1)))))))

(defun read-power (form base exponent)
  (let ((number (rational-number exponent)))
    (cond ((and (integerp number) (<= 2 number +largest-power+) (consp base))
           (let ((factor (read-polynomial base)) (power (constant-polynomial 1)))
             (dotimes (k number power) (setq power (laurent-product power factor)))))
          ((and number (kernel-power :power base number)))
          ((and (eq base 'maxima::$%e) (waves-of exponent :growth 1)))
          (t (kernel-power :power form 1)))))

(defun read-pair (form kind plus minus)
  "PLUS exp(s u) + MINUS exp(- s u), u the argument of FORM, s = %i for waves."
  (let ((up (waves-of (second form) kind 1)) (down (waves-of (second form) kind -1)))
    (if up
        (add-product (constant-polynomial plus) up (add-product (constant-polynomial minus) down (make-hash-table)))
        (kernel-power :power form 1))))

(defun waves-of (argument kind sign)
  "exp(s SIGN ARGUMENT) as one term, a kernel for each term of the argument; nil if that is not possible."
  (let ((product (constant-polynomial 1)) (expanded (maxima::$expand argument)))
    (dolist (term (if (operator-p expanded 'maxima::mplus) (rest expanded) (list expanded)) product)
      (let ((factor (and product (multiple-value-call #'wave-of (split-rational term) kind sign))))
        (setq product (and factor (laurent-product product factor)))))))

(defun split-rational (term)
  "The rational factor of TERM, and the rest."
  (let ((number (and (operator-p term 'maxima::mtimes) (rational-number (second term)))))
    (cond (number (values number (if (cdddr term) (cons (first term) (cddr term)) (third term))))
          ((rational-number term) (values (rational-number term) 1))
          (t (values 1 term)))))

(defun wave-of (number form kind sign) (kernel-power kind form (* sign number)))

;;; Minors

(defun all-minors (rows width)
  "An alist from sets of as many columns as there are ROWS, lists of polynomials or nil for 0, to minors."
  (let ((minors (list (cons 0 (constant-polynomial 1)))))
    (dolist (row rows minors)
      (let ((next '()))
        (loop for (columns . minor) in minors
              do (loop for entry in row
                       for column below width
                       do (when (and entry (not (logbitp column columns)))
                            (let* ((set (logior columns (ash 1 column)))
                                   (pair (or (assoc set next) (first (push (cons set (make-hash-table)) next)))))
                              (add-product minor entry (cdr pair)
                                           (if (oddp (logcount (ash columns (- (1+ column))))) -1 1))))))
        (setq minors (remove-if #'zero-polynomial-p next :key #'cdr))))))

(defun rows-in-order (rows)
  "Rows that bring in few new columns first, so that there are few sets of columns on the way."
  (let ((columns '()) (ordered '()))
    (flet ((places (row) (loop for entry in row for place from 0 when entry collect place)))
      (loop while rows
            do (let ((best (first (sort (copy-list rows) #'<
                                        :key (lambda (row) (+ (* 100 (length (set-difference (places row) columns)))
                                                              (length (places row))))))))
                 (setq columns (union columns (places best))
                       rows (remove best rows :test #'eq :count 1))
                 (push best ordered))))
    (nreverse ordered)))

;;; Common factors

(defun zero-polynomial-p (polynomial) (zerop (hash-table-count polynomial)))

(defun common-key (polynomials)
  "The key of the largest product of powers, not of waves, that divides all POLYNOMIALS."
  (let ((least nil) (bias (key-bias)))
    (dolist (polynomial polynomials)
      (maphash (lambda (key coefficient)
                 (declare (ignore coefficient))
                 (let ((exponents (key-exponents key bias)))
                   (setq least (if least (mapcar #'min least exponents) exponents))))
               polynomial))
    (loop for exponent in least
          for place from 0
          sum (if (eq (kernel-kind (aref *kernels* place)) :wave) 0 (exponent-key place exponent)))))

(defun over-term (polynomial divisor)
  "POLYNOMIAL over the term with the key DIVISOR."
  (let ((quotient (make-hash-table)))
    (maphash (lambda (key coefficient) (setf (gethash (- key divisor) quotient) coefficient)) polynomial)
    quotient))

(defun in-powers-of (place polynomial)
  "An alist from what is left of the keys of POLYNOMIAL without the kernel at PLACE to alists from its exponents to
coefficients, the highest exponent first."
  (let ((parts (make-hash-table)) (list '()) (bias (key-bias)))
    (maphash (lambda (key coefficient)
               (let ((exponent (exponent-at place key bias)))
                 (push (cons exponent coefficient) (gethash (- key (exponent-key place exponent)) parts))))
             polynomial)
    (maphash (lambda (rest terms) (push (cons rest (sort terms #'> :key #'car)) list)) parts)
    list))

(defun over-two-terms (terms step sign)
  "The alist of exponents and coefficients TERMS over z^step + SIGN z^-step, or :inexact."
  (let ((quotient '()))
    (loop while terms
          do (destructuring-bind ((exponent . coefficient) . others) terms
               (let* ((place (- exponent step))
                      (lower (- place step))
                      (pair (assoc lower others))
                      (rest (- (if pair (cdr pair) 0) (* sign coefficient))))
                 (when (< lower (car (first (last terms)))) (return-from over-two-terms :inexact))
                 (push (cons place coefficient) quotient)
                 (setq terms (remove pair others :test #'eq))
                 (unless (eql rest 0)
                   (setq terms (merge 'list (list (cons lower rest)) (copy-list terms) #'> :key #'car))))))
    quotient))

(defun over-wave (polynomial place step sign)
  "POLYNOMIAL over the cosine (SIGN 1) or sine (-1) of STEP units of the angle at PLACE; nil if that is not exact."
  (let ((total (make-hash-table)) (factor (if (= sign 1) 2 #c(0 2))))
    (loop for (key . terms) in (in-powers-of place polynomial)
          do (let ((quotient (over-two-terms terms step sign)))
               (when (eq quotient :inexact) (return-from over-wave nil))
               (loop for (exponent . coefficient) in quotient
                     do (add-term (+ key (exponent-key place exponent)) (* factor coefficient) total))))
    total))

(defun over-waves (polynomial place step sign times)
  (loop repeat times while polynomial do (setq polynomial (over-wave polynomial place step sign)))
  polynomial)

(defun frequency-unit (place polynomials)
  "The greatest common divisor of the exponents of the kernel at PLACE."
  (let ((unit 0) (bias (key-bias)))
    (dolist (polynomial polynomials unit)
      (maphash (lambda (key coefficient)
                 (declare (ignore coefficient))
                 (setq unit (gcd unit (exponent-at place key bias))))
               polynomial))))

(defun without-common-waves (one two)
  "ONE and TWO without the sines and cosines of single angles that divide both: where the frequencies are even also
those of half the unit, else the squares of these, which are 1 + cos and 1 - cos."
  (dotimes (place (length *kernels*) (values one two))
    (when (eq (kernel-kind (aref *kernels* place)) :wave)
      (let ((unit (frequency-unit place (list one two))))
        (loop for (step times) in (cond ((zerop unit) '())
                                        ((zerop (mod unit (* 2 +exponent-unit+))) (list (list (/ unit 2) 1)))
                                        ((evenp unit) (list (list unit 1) (list (/ unit 2) 2)))
                                        (t (list (list unit 1))))
              do (dolist (sign '(1 -1))
                   (loop for over-two = (over-waves two place step sign times)
                         for over-one = (and over-two (over-waves one place step sign times))
                         while over-one
                         do (setq one over-one two over-two))))))))

(defun without-common-factors (one two)
  "ONE and TWO without the powers, sines and cosines that divide both."
  (let ((divisor (common-key (list one two))))
    (without-common-waves (over-term one divisor) (over-term two divisor))))

;;; Writing

(defun written-power (kernel units)
  (let* ((exponent (/ units +exponent-unit+))
         (form (if (integerp exponent) exponent
                   (list '(maxima::rat maxima::simp) (numerator exponent) (denominator exponent)))))
    (if (eq (kernel-kind kernel) :power)
        (power-of (kernel-form kernel) form)
        (power-of 'maxima::$%e (product-of form (kernel-form kernel))))))

(defun written-number (number)
  (if (integerp number) number (list '(maxima::rat maxima::simp) (numerator number) (denominator number))))

(defun angle-of (exponents)
  "The sum of EXPONENTS, in units, times the angles."
  (maxima::simplifya
   (cons '(maxima::mplus)
         (loop for units in exponents
               for kernel across *kernels*
               unless (zerop units)
                 collect (product-of (written-number (/ units +exponent-unit+)) (kernel-form kernel))))
   t))

(defun split-key (key)
  "The exponents of KEY that belong to waves, and the others."
  (loop for units in (key-exponents key (key-bias))
        for kernel across *kernels*
        for wave = (eq (kernel-kind kernel) :wave)
        collect (if wave units 0) into waves
        collect (if wave 0 units) into others
        finally (return (values waves others))))

(defun written-terms (key coefficient varying)
  "What the term and its conjugate are together: a list of (factor . constant), FACTOR holding what VARYING holds of."
  (multiple-value-bind (waves others) (split-key key)
    (let* ((leading (find 0 waves :test-not #'eql))
           (powers (loop for units in others
                         for kernel across *kernels*
                         unless (zerop units) collect (written-power kernel units)))
           (fixed (remove-if varying powers))
           (moving (remove-if-not varying powers)))
      (flet ((pair (function number)
               (unless (zerop number)
                 (let ((wave (function-of function (angle-of waves))))
                   (list (cons (apply #'product-of (if (funcall varying wave) (cons wave moving) moving))
                               (apply #'product-of (written-number number)
                                      (if (funcall varying wave) fixed (cons wave fixed)))))))))
        (cond ((null leading)
               (list (cons (apply #'product-of moving)
                           (apply #'product-of (written-number (realpart coefficient)) fixed))))
              ((minusp leading) '())
              (t (append (pair 'maxima::%cos (* 2 (realpart coefficient)))
                         (pair 'maxima::%sin (* -2 (imagpart coefficient))))))))))

(defun written-polynomial (polynomial varying)
  "A Maxima list of [coefficient, factor], whose sum of products is POLYNOMIAL; factors hold what varies."
  (let ((groups (make-hash-table :test #'equal)) (order '()))
    (maphash (lambda (key coefficient)
               (loop for (factor . constant) in (written-terms key coefficient varying)
                     for name = (plain-key factor)
                     do (unless (gethash name groups) (push (cons name factor) order))
                        (push constant (gethash name groups))))
             polynomial)
    (maxima-list (loop for (name . factor) in order
                       collect (maxima-list (list (sum-of (gethash name groups)) factor))))))

(defun varying-test (state)
  "A predicate: whether a form holds one of STATE."
  (let ((keys (mapcar #'plain-key state)))
    (lambda (form)
      (labels ((holds (form)
                 (or (member (plain-key form) keys :test #'equal)
                     (and (consp form) (some #'holds (rest form))))))
        (holds form)))))

(defun written-quotient (numerator denominator varying)
  (multiple-value-bind (numerator denominator)
      (if (zero-polynomial-p numerator)
          (values numerator (constant-polynomial 1))
          (without-common-factors numerator denominator))
    (maxima-list (list (written-polynomial numerator varying) (written-polynomial denominator varying)))))

(defmacro with-kernels ((most) &body body)
  "Evaluate BODY with no kernels read as yet; not found if it is given up, for one after MOST products of terms."
  `(let ((*kernels* (make-array 32 :adjustable t :fill-pointer 0))
         (*kernel-places* (make-hash-table :test #'equal))
         (*products-left* ,most))
     (catch 'minors ,@body)))

(maxima::defmfun maxima::$anmech_wave_minors (rows state most)
  "anmech_wave_minors(rows, state, most): for rows [A | b] of A u = b with n equations the list of n pairs [N, D] with
u = N/D, N and D each a list of [coefficient, factor] whose sum of products it is; the factors hold what holds
variables of state.  None where det A = 0.  Not found if it takes more than so many products of terms (too_long), or
where entries hold floats or %i (inexact)."
  (with-kernels (most) (quotients-of-minors (rest rows) (varying-test (rest state)))))

(defun quotients-of-minors (rows varying)
  (let* ((n (length rows))
         (minors (all-minors (rows-in-order (mapcar #'read-row rows)) (1+ n)))
         (all (1- (ash 1 (1+ n)))))
    (flet ((without (column) (or (cdr (assoc (logxor all (ash 1 column)) minors)) (constant-polynomial 0))))
      (if (zero-polynomial-p (without n))
          (maxima::$anmech_none)
          ;; b is the last column of the minor without column k; moved to its place it passes n - 1 - k columns
          (maxima-list (loop for k below n
                             for minor = (without k)
                             collect (written-quotient (if (oddp (- n 1 k)) (negated minor) minor) (without n)
                                                       varying)))))))

(defun read-row (row)
  "The entries of a row as polynomials, nil for zero."
  (mapcar (lambda (entry)
            (let ((polynomial (read-polynomial entry)))
              (if (zero-polynomial-p polynomial) nil polynomial)))
          (rest row)))

(defun negated (polynomial) (add-product (constant-polynomial -1) polynomial (make-hash-table)))
