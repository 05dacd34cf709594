;;; anmech: which functions can take part in a linear relation at all?
;;;
;;; anmech_relations (relations.lisp) splits functions into monomials, and for long quotients that is much work, though mostly
;;; there is nothing to be found.  Here the functions are first evaluated at random points, modulo a prime: the numbers obey
;;; every relation that the functions obey.  So what is independent there needs no symbolic work, and only the columns in
;;; the relations of the numbers are looked at exactly.
;;;
;;; The values obey the laws of powers, of square roots, of exponentials (of sums and rational multiples) and of sines and
;;; cosines; any other function of given arguments is a number of its own.  An expression with something else (%i, cube roots)
;;; is not sifted.
;;;
;;; Entry point: anmech_sifted_relations.
;;;
;;; Source: J. T. Schwartz, Fast probabilistic algorithms for verification of polynomial identities, J. ACM 27 (1980) 701.

(in-package :anmech)

(defconstant +finest-part+ 60
  "Exponents and angles are whole multiples of this part of a monomial; what is not is not sifted.")

(defun give-up-sifting () (throw 'sifting :given-up))
(defun leave-point () (throw 'point nil))

;;; Expressions as programs: a vector of instructions (operator . operands), operands being numbers of earlier ones.

(defstruct sieve
  "INSTRUCTIONS in reverse, their COUNT and a table from instruction to number; the VARIABLES of the relations."
  (instructions '()) (count 0) (known (make-hash-table :test #'equal)) variables)

(defun instruct (sieve &rest instruction)
  "The number of INSTRUCTION."
  (or (gethash instruction (sieve-known sieve))
      (progn (push instruction (sieve-instructions sieve))
             (incf (sieve-count sieve))
             (setf (gethash instruction (sieve-known sieve)) (1- (sieve-count sieve))))))

(defun instruct-unknown (sieve kind form)
  "A random number for the KIND of function of FORM: the same at all points if it is one of parameters, since these may be in
the coefficients of a relation."
  (instruct sieve (if (depends-p form (sieve-variables sieve)) :variable :parameter)
            (format nil "~a ~s" kind (form-without-flags form))))

(defun instruct-form (sieve form)
  (cond ((typep form 'rational) (instruct sieve :number (residue-of-number form)))
        ((floatp form) (instruct sieve :number (residue-of-number (rationalize form))))
        ((eq form 'maxima::$%i) (give-up-sifting))
        ((eq form 'maxima::$%e) (instruct-exponential sieve 1))
        ((atom form) (instruct-unknown sieve :value form))
        (t (case (caar form)
             (maxima::rat (instruct sieve :number (residue-of-number (/ (second form) (third form)))))
             (maxima::mplus (instruct-many sieve :sum (rest form)))
             (maxima::mtimes (instruct-many sieve :product (rest form)))
             (maxima::mexpt (instruct-power sieve (second form) (as-rational (third form))))
             ((maxima::%sin maxima::%cos maxima::%tan maxima::%sec maxima::%csc maxima::%cot)
              (instruct-circle sieve (caar form) (second form)))
             ((maxima::%sinh maxima::%cosh maxima::%tanh maxima::%sech maxima::%csch maxima::%coth)
              (instruct-hyperbola sieve (caar form) (second form)))
             (t (instruct-unknown sieve :value form))))))

(defun instruct-many (sieve operator forms)
  (apply #'instruct sieve operator (mapcar (lambda (form) (instruct-form sieve form)) forms)))

(defun instruct-power (sieve base exponent)
  (cond ((eq base 'maxima::$%e) (instruct-exponential sieve (as-form exponent)))
        ((integerp exponent) (instruct sieve :power (instruct-form sieve base) exponent))
        ((and (typep exponent 'ratio) (= (denominator exponent) 2))
         (instruct sieve :power (instruct sieve :root (instruct-form sieve base)) (numerator exponent)))
        ((typep exponent 'ratio) (give-up-sifting))
        (t (instruct-symbolic-power sieve base exponent))))

(defun multiples-in (form)
  "FORM as a list of (monomial . whole multiple of its finest part)."
  (let ((expanded (maxima::$expand form)))
    (mapcar (lambda (term)
              (let* ((number (if (operator-p term 'maxima::mtimes) (as-rational (second term)) (as-rational term)))
                     (factor (if (typep number 'rational) (* +finest-part+ number) +finest-part+)))
                (unless (integerp factor) (give-up-sifting))
                (cons (cond ((not (typep number 'rational)) term)
                            ((operator-p term 'maxima::mtimes) (apply #'product-of (cddr term)))
                            (t 1))
                      factor)))
            (if (operator-p expanded 'maxima::mplus) (rest expanded) (list expanded)))))

(defun instruct-exponential (sieve exponent)
  (apply #'instruct sieve :product
         (loop for (monomial . factor) in (multiples-in exponent)
               collect (instruct sieve :power (instruct-unknown sieve :exp monomial) factor))))

(defun instruct-symbolic-power (sieve base exponent)
  "b^e as exp(e log b); powers of products are products of powers to Maxima already."
  (apply #'instruct sieve :product
         (loop for (monomial . factor) in (multiples-in exponent)
               collect (if (eql monomial 1)
                           (if (zerop (mod factor +finest-part+))
                               (instruct sieve :power (instruct-form sieve base) (/ factor +finest-part+))
                               (give-up-sifting))
                           (instruct sieve :power
                                     (instruct-unknown sieve :power (list '(maxima::mlist) base monomial)) factor)))))

(defun instruct-circle (sieve function angle)
  "A pair (cosine, sine) is one instruction; the values are picked from it."
  (let* ((pair (apply #'instruct sieve :turns
                      (loop for (monomial . factor) in (multiples-in angle)
                            append (list (instruct-unknown sieve :turn monomial) factor))))
         (cosine (instruct sieve :cosine pair))
         (sine (instruct sieve :sine pair)))
    (flet ((quotient (a b) (instruct sieve :product a (instruct sieve :power b -1))))
      (ecase function
        (maxima::%sin sine)
        (maxima::%cos cosine)
        (maxima::%tan (quotient sine cosine))
        (maxima::%cot (quotient cosine sine))
        (maxima::%sec (instruct sieve :power cosine -1))
        (maxima::%csc (instruct sieve :power sine -1))))))

(defun instruct-hyperbola (sieve function argument)
  (let* ((e (instruct-exponential sieve argument))
         (inverse (instruct sieve :power e -1))
         (half (instruct sieve :number (residue-of-number 1/2)))
         (cosine (instruct sieve :product half (instruct sieve :sum e inverse)))
         (sine (instruct sieve :product half
                         (instruct sieve :sum e (instruct sieve :product (instruct sieve :number (1- +prime+)) inverse)))))
    (flet ((quotient (a b) (instruct sieve :product a (instruct sieve :power b -1))))
      (ecase function
        (maxima::%sinh sine)
        (maxima::%cosh cosine)
        (maxima::%tanh (quotient sine cosine))
        (maxima::%coth (quotient cosine sine))
        (maxima::%sech (instruct sieve :power cosine -1))
        (maxima::%csch (instruct sieve :power sine -1))))))

;;; Values modulo the prime

(defun random-residue (text)
  (1+ (floor (* (- +prime+ 2) (scrambled text)))))

(defun times-modulo-prime (a b) (mod (* a b) +prime+))

(defun power-modulo-prime (base exponent)
  (when (minusp exponent)
    (when (zerop base) (leave-point))
    (setq base (inverse-modulo-prime base) exponent (- exponent)))
  (let ((result 1))
    (loop while (plusp exponent)
          do (when (oddp exponent) (setq result (times-modulo-prime result base)))
             (setq base (times-modulo-prime base base) exponent (ash exponent -1)))
    result))

(defun root-modulo-prime (a)
  "The square root that is a square itself, so that roots of products are products of roots."
  (let ((root (power-modulo-prime a (/ (1+ +prime+) 4))))
    (unless (= a (times-modulo-prime root root)) (leave-point))
    root))

(defun turned (a b)
  (destructuring-bind ((c . s) (d . z)) (list a b)
    (cons (mod (- (* c d) (* s z)) +prime+) (mod (+ (* c z) (* s d)) +prime+))))

(defun turn-modulo-prime (parameter factor)
  "The FACTOR-th multiple of the angle whose half has the tangent PARAMETER."
  (let* ((square (times-modulo-prime parameter parameter))
         (inverse (power-modulo-prime (mod (1+ square) +prime+) -1))
         (pair (cons (times-modulo-prime (- 1 square) inverse) (times-modulo-prime (* 2 parameter) inverse)))
         (result (cons 1 0)))
    (when (minusp factor) (setq pair (cons (car pair) (mod (- (cdr pair)) +prime+)) factor (- factor)))
    (loop while (plusp factor)
          do (when (oddp factor) (setq result (turned result pair)))
             (setq pair (turned pair pair) factor (ash factor -1)))
    result))

(defun values-at-point (instructions seed)
  "The values of all instructions at the point of number SEED; nil where one of them has none."
  (let ((found (make-array (length instructions))) (*seed* seed) (place 0))
    (flet ((value (number) (svref found number)))
      (catch 'point
        (dolist (instruction instructions found)
          (setf (svref found place)
                (destructuring-bind (operator . operands) instruction
                  (ecase operator
                    (:number (first operands))
                    (:variable (random-residue (first operands)))
                    (:parameter (let ((*seed* 0)) (random-residue (first operands))))
                    (:sum (mod (loop for operand in operands sum (value operand)) +prime+))
                    (:product (let ((product 1))
                                (dolist (operand operands product)
                                  (setq product (times-modulo-prime product (value operand))))))
                    (:power (power-modulo-prime (value (first operands)) (second operands)))
                    (:root (root-modulo-prime (value (first operands))))
                    (:turns (let ((pair (cons 1 0)))
                              (loop for (operand factor) on operands by #'cddr
                                    do (setq pair (turned pair (turn-modulo-prime (value operand) factor))))
                              pair))
                    (:cosine (car (value (first operands))))
                    (:sine (cdr (value (first operands)))))))
          (incf place))))))

;;; Rows of values

(defun sifting-rows (columns variables)
  "Enough rows of values of COLUMNS, lists of forms of equal length, as vectors."
  (let* ((sieve (make-sieve :variables variables))
         (components (length (first columns)))
         (places (loop for component below components
                       collect (mapcar (lambda (column) (instruct-form sieve (nth component column))) columns)))
         (instructions (reverse (sieve-instructions sieve)))
         (wanted (ceiling (+ 10 (length columns)) components))
         (rows '()))
    (loop for seed from 1
          while (plusp wanted)
          do (when (> seed (+ 100 (* 40 wanted))) (give-up-sifting))
             (let ((found (values-at-point instructions seed)))
               (when found
                 (decf wanted)
                 (dolist (numbers places)
                   (push (map 'vector (lambda (number) (svref found number)) numbers) rows)))))
    rows))

(defun cleared-row (row pivots)
  "ROW without the leading columns of PIVOTS, (column . row) with a 1 there."
  (loop for (column . pivot) in pivots
        for factor = (svref row column)
        unless (zerop factor)
          do (loop for k from column below (length row)
                   do (setf (svref row k) (mod (- (svref row k) (* factor (svref pivot k))) +prime+))))
  row)

(defun sifted-columns (rows count)
  "The numbers of the columns, of COUNT, that are in some relation of the numbers in ROWS."
  (let ((pivots '()))
    (dolist (row rows)
      (when (= (length pivots) count) (return))
      (let* ((row (cleared-row row (reverse pivots))) (column (position 0 row :test-not #'eql)))
        (when column
          (let ((scale (inverse-modulo-prime (svref row column))))
            (push (cons column (map 'vector (lambda (value) (times-modulo-prime scale value)) row)) pivots)))))
    (columns-in-relations
     (mapcar (lambda (pivot)
               (loop for k from (car pivot) below count
                     unless (eql 0 (svref (cdr pivot) k)) collect (cons k (svref (cdr pivot) k))))
             (reverse pivots))
     count)))

(maxima::defmfun maxima::$anmech_sifted_relations (columns variables)
  "anmech_sifted_relations(columns, variables): as anmech_relations, quicker for long expressions with few relations."
  (let* ((columns (rest columns)) (count (length columns))
         (kept (catch 'sifting
                 (if (or (null columns) (null (rest (first columns))))
                     (give-up-sifting)
                     (sifted-columns (sifting-rows (mapcar #'rest columns) (rest variables)) count)))))
    (if (eq kept :given-up)
        (maxima::$anmech_relations (maxima-list columns) variables)
        (maxima-list
         (mapcar (lambda (vector)
                   (maxima-list (loop for k below count
                                      for place = (position k kept)
                                      collect (if place (nth place (rest vector)) 0))))
                 (and kept (rest (maxima::$anmech_relations (maxima-list (mapcar (lambda (k) (nth k columns)) kept))
                                                            variables))))))))
