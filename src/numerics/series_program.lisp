;;; anmech: straight-line programs of power series, by which the Taylor coefficients of a motion are computed.
;;;
;;; A *series program* is made of the straight-line program of a model (sharing.lisp), and knows as little arithmetic.
;;; Its instructions compute series in the time that has passed, the coefficient of each order from those of the same
;;; order of what stands before, and from lower ones: so one goes through all instructions with order 0, then with
;;; order 1, and so on; after each order the rates give the coefficients of the states of the next one.  What does not
;;; change along a motion (numbers, parameters, sides of surfaces) is a *constant*, computed once; the product of a
;;; constant and a series takes one multiplication an order, that of two series as many as the order says.
;;;
;;; The series are numbered: 0 to n - 1 are the states, n is the time, n + 1 + i is what instruction i gives.  Of an
;;; instruction y = (operation ..), with series a, b, d, q and constants c, y[k] is the coefficient of order k:
;;;
;;;   (:add a b) (:subtract a b) (:negate a)
;;;   (:shift a c) (:scale a c) (:over a c)        a + c, a*c, a/c
;;;   (:fixed c)                                   the constant as a series
;;;   (:multiply a b) (:square a)                  y[k] = sum a[j] b[k-j], j = 0..k
;;;   (:divide a b)                                y[k] = (a[k] - sum b[j] y[k-j], j = 1..k)/b[0]
;;;   (:reciprocal a c)                            c/a: the same with c for the dividend
;;;   (:sqrt a)                                    y[k] = (a[k] - sum y[j] y[k-j], j = 1..k-1)/(2 y[0])
;;;   (:power a c)                                 y[k] = sum (c*(k-j) - j) a[k-j] y[j], j = 0..k-1, over k a[0]
;;;   (:primitive f a q sign)                      y = f(a), y' = sign a' q:
;;;                                                y[k] = sign sum j a[j] q[k-j], j = 1..k, over k
;;;   (:primitive-over f a d sign)                 y = f(a), y' d = sign a':
;;;                                                y[k] = (sign k a[k] - sum j y[j] d[k-j], j = 1..k-1)/(k d[0])
;;;   (:angle b a d)                               atan2(b, a), where d = a^2 + b^2:  y' d = b' a - a' b
;;;   (:absolute a) (:sign a) (:floor a) (:larger a b) (:smaller a b)    decided by the coefficients of order 0; where
;;;                                                they matter the steps end (surfaces.lisp)
;;;
;;; The series q of :primitive may stand behind it: only its lower orders are needed.  A factor of a series that is no
;;; series is a pair (:constant . c); of the constants, each is (operation operand operand) as in a program, its
;;; operands numbers of earlier constants, or (:input . i), (:number . rational), (:constant . name).
;;;
;;; The rate of a state is a series, (:constant . c), or (:unknown . i) of linear equations A u = b.  These are left as
;;; they are: with A[0] factored once a step, the coefficient of order k is that of
;;; A[0] u[k] = b[k] - sum A[j] u[k-j], j = 1..k, where constant entries of A have no sum.
;;;
;;; Entry points: the structures SERIES-PROGRAM and LINEAR-SERIES; MODEL-SERIES-PROGRAM, SERIES-PROGRAM-OF,
;;; SUMS-OF-PRODUCTS; SERIES-EVALUATOR, which runs one with any numbers, slowly.
;;;
;;; Literature: R. E. Moore, Interval Analysis (1966), chapter 11; D. Barton, I. M. Willers, R. V. M. Zahar, Computer
;;; J. 14 (1971) 243-248; A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed. 2008, chapter 13; A. Jorba, M. Zou,
;;; Experimental Mathematics 14 (2005) 99-117.

(in-package :anmech)
(needs "arithmetic/elimination" "arithmetic/floats" "numerics/arrangement" "numerics/codegen" "numerics/dag"
       "numerics/evaluation" "numerics/model" "numerics/sharing")

(defstruct (series-program (:print-function print-dots))
  (states 0)             ; how many
  constants              ; vectors, see above
  instructions
  constant-guards        ; alists: of a number of a constant, or of an instruction, what a domain violation tells
  guards
  rates                  ; of each state
  linear                 ; LINEAR-SERIES, or nil
  (kernels '()))         ; what methods have made of it: an alist

(defstruct linear-series
  "A u = b: a list (row column operand) for each entry of A that is not zero, and a list of operands."
  size entries rights)

(defun sums-of-products (series)
  "How many sums of as many products the coefficients of one order take: those of instructions, and of the entries of
linear equations that vary."
  (let ((linear (series-program-linear series)))
    (+ (count-if (lambda (instruction)
                   (member (first instruction) '(:multiply :square :divide :reciprocal :sqrt :power :primitive
                                                 :primitive-over :angle)))
                 (series-program-instructions series))
       (if linear (count-if-not #'consp (linear-series-entries linear) :key #'third) 0))))

;;; What is being made

(defvar *making* nil "The series program that is being made; its vectors have fill pointers.")
(defvar *made* nil "From constants and instructions to operands.")
(defvar *guard* nil "The pair (operation . source) of the instruction that is being translated, or nil.")

(defun constant-operand (form)
  "The pair of the constant FORM.  It is not noted under its own name: there may be an instruction (:add 0 1), too,
whose numbers are those of series."
  (let ((key (cons :constant form)))
    (or (gethash key *made*)
        (let ((index (vector-push-extend form (series-program-constants *making*))))
          (when *guard* (push (cons index *guard*) (series-program-constant-guards *making*)))
          (setf (gethash key *made*) (cons :constant index))))))

(defun next-series () (+ 1 (series-program-states *making*) (length (series-program-instructions *making*))))

(defun series-instruction (&rest instruction)
  "The number of the series that INSTRUCTION gives."
  (or (gethash instruction *made*)
      (let ((index (next-series)))
        (when *guard*
          (push (cons (length (series-program-instructions *making*)) *guard*) (series-program-guards *making*)))
        (vector-push-extend instruction (series-program-instructions *making*))
        (setf (gethash instruction *made*) index))))

(defun number-constant (number) (cdr (constant-operand (cons :number number))))

(defun as-series (operand) (if (consp operand) (series-instruction :fixed (cdr operand)) operand))

;;; From instructions of numbers to those of series

(defun translated (operation a b)
  "The operand that OPERATION gives of the operands A and B, or of A alone."
  (if (and (consp a) (or (null b) (consp b)))
      (constant-operand (list* operation (cdr a) (and b (list (cdr b)))))
      (ecase operation
        (:add (cond ((consp a) (series-instruction :shift b (cdr a)))
                    ((consp b) (series-instruction :shift a (cdr b)))
                    (t (series-instruction :add a b))))
        (:subtract (cond ((consp a) (series-instruction :shift (series-instruction :negate b) (cdr a)))
                         ((consp b) (series-instruction :shift a (cdr (translated :negate b nil))))
                         (t (series-instruction :subtract a b))))
        (:multiply (cond ((consp a) (series-instruction :scale b (cdr a)))
                         ((consp b) (series-instruction :scale a (cdr b)))
                         ((eql a b) (series-instruction :square a))
                         (t (series-instruction :multiply a b))))
        (:divide (cond ((consp a) (series-instruction :reciprocal b (cdr a)))
                       ((consp b) (series-instruction :over a (cdr b)))
                       (t (series-instruction :divide a b))))
        (:expt (translated-power a b))
        ((:negate :sqrt) (series-instruction operation a))
        (:abs (series-instruction :absolute a))
        (:signum (series-instruction :sign a))
        (:floor (series-instruction :floor a))
        (:max (series-instruction :larger (as-series a) (as-series b)))
        (:min (series-instruction :smaller (as-series a) (as-series b)))
        (:atan2 (translated-angle (as-series a) (as-series b)))
        ((:sin :cos :sinh :cosh) (translated-pair operation a))
        ((:exp :tan :tanh) (translated-primitive operation a))
        ((:erf :erfc) (translated-error-function operation a))
        ((:log :asin :acos :atan :asinh :acosh :atanh)
         (multiple-value-bind (derivative sign) (reciprocal-derivative operation a)
           (series-instruction :primitive-over operation a derivative sign))))))

(defun translated-power (base exponent)
  (if (and (integerp base) (consp exponent))
      (series-instruction :power base (cdr exponent))
      (translated :exp (translated :multiply exponent (translated :log base nil)) nil)))

(defun translated-angle (y x)
  (series-instruction :angle y x (translated :add (translated :multiply x x) (translated :multiply y y))))

(defun translated-pair (operation a)
  "Sine and cosine, each by the other."
  (destructuring-bind (odd even sign) (if (member operation '(:sin :cos)) '(:sin :cos -1) '(:sinh :cosh 1))
    (let* ((known (gethash (list :pair odd a) *made*))
           (first (or known (setf (gethash (list :pair odd a) *made*) (next-series)))))
      (unless known
        (series-instruction :primitive odd a (1+ first) 1)
        (series-instruction :primitive even a first sign))
      (if (eq operation odd) first (1+ first)))))

(defun translated-primitive (operation a)
  "exp' = exp, tan' = 1 + tan^2, tanh' = -(tanh^2 - 1)."
  (let ((key (list :alone operation a)))
    (or (gethash key *made*)
        (let ((place (next-series)))
          (setf (gethash key *made*) place)
          (ecase operation
            (:exp (series-instruction :primitive :exp a place 1))
            ((:tan :tanh)
             (series-instruction :primitive operation a (+ 2 place) (if (eq operation :tan) 1 -1))
             (series-instruction :shift (series-instruction :square place)
                                 (number-constant (if (eq operation :tan) 1 -1)))))
          place))))

(defun translated-error-function (operation a)
  "Its derivative is 2/sqrt(%pi) exp(-a^2)."
  (let* ((root (translated :sqrt (constant-operand '(:constant . maxima::$%pi)) nil))
         (factor (translated :divide (constant-operand '(:number . 2)) root))
         (bell (translated :exp (translated :negate (translated :multiply a a) nil) nil)))
    (series-instruction :primitive operation a (translated :multiply factor bell) (if (eq operation :erf) 1 -1))))

(defun reciprocal-derivative (operation a)
  "What divides a' in the derivative of OPERATION at a, and the sign."
  (flet ((square () (series-instruction :square a))
         (shifted (series number) (series-instruction :shift series (number-constant number)))
         (negative (series) (series-instruction :negate series))
         (root (series) (series-instruction :sqrt series)))
    (ecase operation
      (:log (values a 1))
      (:atan (values (shifted (square) 1) 1))
      (:atanh (values (shifted (negative (square)) 1) 1))
      (:asin (values (root (shifted (negative (square)) 1)) 1))
      (:acos (values (root (shifted (negative (square)) 1)) -1))
      (:asinh (values (root (shifted (square) 1)) 1))
      (:acosh (values (root (shifted (square) -1)) 1)))))

;;; Powers: b*sqrt(b) and its reciprocal take one sum an order as b^(3/2) and b^(-3/2), three as they are written

(defun powers-in (program)
  "PROGRAM's instructions, in which products with square roots, and their reciprocals, are powers of one base."
  (let* ((instructions (copy-seq (program-instructions program)))
         (powers (make-array (length instructions) :initial-element nil)))
    (flet ((power-of (operand) (or (and (integerp operand) (aref powers operand)) (cons operand 1)))
           (note (k base exponent)
             (setf (aref powers k) (cons base exponent))
             (unless (or (integerp exponent) (= exponent 1/2))
               (setf (aref instructions k) (list :expt base (cons :number exponent))))))
      (dotimes (k (length instructions) instructions)
        (destructuring-bind (operation a &optional b) (aref instructions k)
          (destructuring-bind ((base . exponent) (other . more)) (list (power-of a) (power-of b))
            (case operation
              (:sqrt (when (eql exponent 1) (note k base 1/2)))
              (:multiply (when (equal base other) (note k base (+ exponent more))))
              (:divide (when (and (equal a '(:number . 1)) (not (integerp more)) (> more 1))
                         (note k other (- more)))))))))))

(defun needed-instructions (instructions results)
  "Flags of those that RESULTS depend on."
  (let ((needed (make-array (length instructions) :initial-element nil)))
    (flet ((need (operand) (when (integerp operand) (setf (aref needed operand) t))))
      (mapc #'need results)
      (loop for k from (1- (length instructions)) downto 0
            do (when (aref needed k) (mapc #'need (rest (aref instructions k)))))
      needed)))

;;; Whole programs

(defun series-program-of (program states)
  "The series program of PROGRAM without rates and linear equations, and the operands of its results.  The first STATES
inputs are the states, the next one is the time."
  (let* ((*making* (make-series-program :states states
                                        :constants (make-array 16 :adjustable t :fill-pointer 0)
                                        :instructions (make-array 32 :adjustable t :fill-pointer 0)))
         (*made* (make-hash-table :test 'equal)) (*guard* nil)
         (instructions (powers-in program)) (needed (needed-instructions instructions (program-results program)))
         (operands (make-array (length instructions) :initial-element nil)))
    (labels ((operand (item)
               (cond ((null item) nil)
                     ((integerp item) (aref operands item))
                     ((and (eq :input (car item)) (<= (cdr item) states)) (cdr item))
                     (t (let ((*guard* nil)) (constant-operand item))))))
      (dotimes (k (length instructions))
        (when (aref needed k)
          (destructuring-bind (operation a &optional b) (aref instructions k)
            (let* ((first (operand a)) (second (operand b)) (*guard* (cdr (assoc k (program-guards program)))))
              (setf (aref operands k) (translated operation first second))))))
      (values *making* (mapcar #'operand (program-results program))))))

(defun model-series-program (model &optional exact)
  "The series program of MODEL, in doubles or, EXACT, with constants that are not rounded; on the sides of surfaces."
  (or (cdr (assoc exact (model-series model)))
      (let ((series (new-series-program model exact)))
        (push (cons exact series) (model-series model))
        series)))

(defun new-series-program (model exact)
  (multiple-value-bind (series operands)
      (series-program-of (if exact (exact-smooth-program model) (model-program model)) (model-dimension model))
    (let ((arrangement (model-arrangement model)))
      (setf (series-program-linear series) (and arrangement (linear-series-of arrangement operands))
            (series-program-rates series)
            (if arrangement
                (append (model-places model)
                        (unknown-rates arrangement operands (- (model-dimension model) (model-solved model))))
                operands))
      series)))

(defun exact-smooth-program (model)
  "As MODEL-EXACT-PROGRAM, but with the sides of surfaces as inputs."
  (if (model-surfaces model)
      (with-compilation-errors
        (lambda ()
          (expressions-program (general-forms (model-equations model)) (model-inputs model) :round-constants nil)))
      (model-exact-program model)))

(defun linear-series-of (arrangement operands)
  "The equations of ARRANGEMENT, whose entries, right sides and quotients are OPERANDS."
  (let* ((elimination (arrangement-elimination arrangement)) (size (elimination-size elimination))
         (whole (null (elimination-rows elimination)))
         (rows (if whole
                   (loop for i below size append (loop repeat size collect i))
                   (coerce (elimination-rows elimination) 'list)))
         (columns (if whole
                      (loop repeat size append (loop for j below size collect j))
                      (coerce (elimination-columns elimination) 'list))))
    (make-linear-series
     :size size
     :entries (loop for i in rows
                    for j in columns
                    for operand in operands
                    collect (list i j operand)
                    when (and (elimination-symmetric elimination) (/= i j)) collect (list j i operand))
     :rights (subseq operands (length rows) (+ (length rows) size)))))

(defun unknown-rates (arrangement operands count)
  "Of the first COUNT unknowns."
  (let* ((elimination (arrangement-elimination arrangement)) (size (elimination-size elimination))
         (entries (if (elimination-rows elimination) (length (elimination-rows elimination)) (* size size))))
    (loop for source across (subseq (arrangement-sources arrangement) 0 count)
          for place = (- -1 source)
          collect (cond ((>= source 0) (cons :unknown source))
                        ((< place (+ entries size)) (cons :unknown (- place entries)))
                        (t (nth place operands))))))

;;; Run with any numbers

(defun series-evaluator (series type)
  "A function (in order) of a vector of numbers of TYPE, like the input of the field: for each state the vector of its
coefficients of the orders 0 to ORDER, of the powers of the time that has passed."
  (lambda (in order)
    (let* ((n (series-program-states series)) (instructions (series-program-instructions series))
           (constants (constant-values series type in))
           (rows (make-array (+ n 1 (length instructions)))) (matrix nil) (unknowns nil))
      (labels ((operate (operation &rest operands)
                 (or (apply (number-type-operate type) operation operands)
                     (error 'domain-violation :operation operation :source nil)))
               (number (number) (funcall (number-type-number type) number))
               (row (operand k)
                 "The coefficient of order K."
                 (cond ((integerp operand) (aref (aref rows operand) k))
                       ((eq :unknown (car operand)) (aref (aref unknowns k) (cdr operand)))
                       ((zerop k) (aref constants (cdr operand)))
                       (t (number 0)))))
        (map-into rows (lambda () (make-array (1+ order) :initial-element (number 0))))
        (setq unknowns (make-array (1+ order)))
        (dotimes (i (1+ n)) (setf (aref (aref rows i) 0) (aref in i)))
        (when (plusp order) (setf (aref (aref rows n) 1) (number 1)))
        (dotimes (k order (subseq rows 0 n))
          (loop for instruction across instructions
                for place from (1+ n)
                for guard = (cdr (assoc (- place n 1) (series-program-guards series)))
                do (setf (aref (aref rows place) k)
                         (handler-case (series-coefficient instruction k place #'row (lambda (c) (aref constants c))
                                                           #'operate #'number)
                           (domain-violation (condition)
                             (error 'domain-violation :operation (or (car guard) (violated-operation condition))
                                                      :source (cdr guard))))))
          (when (series-program-linear series)
            (unless matrix (setq matrix (inverted-matrix (series-program-linear series) #'row #'operate #'number)))
            (setf (aref unknowns k)
                  (unknown-coefficients (series-program-linear series) k matrix #'row unknowns #'operate #'number)))
          (loop for rate in (series-program-rates series)
                for i from 0
                do (setf (aref (aref rows i) (1+ k)) (operate :divide (row rate k) (number (1+ k))))))))))

(defun constant-values (series type in)
  "Numbers of TYPE."
  (let ((values (make-array (length (series-program-constants series)))))
    (dotimes (i (length values) values)
      (destructuring-bind (head . rest) (aref (series-program-constants series) i)
        (setf (aref values i)
              (case head
                (:input (aref in rest))
                (:number (funcall (number-type-number type) rest))
                (:constant (funcall (number-type-constant type) rest))
                (t (or (apply (number-type-operate type) head (mapcar (lambda (c) (aref values c)) rest))
                       (let ((guard (cdr (assoc i (series-program-constant-guards series)))))
                         (error 'domain-violation :operation head :source (cdr guard)))))))))))

(defun series-coefficient (instruction k place row constant operate number)
  "The coefficient of order K of INSTRUCTION, whose own series is at PLACE."
  (destructuring-bind (operation a &optional b c d) instruction
    (labels ((at (series k) (funcall row series k))
             (constant (c) (funcall constant c))
             (operate (operation &rest operands) (apply operate operation operands))
             (times (integer x) (operate :multiply (funcall number integer) x))
             (over (x integer) (operate :divide x (funcall number integer)))
             (sum (from to term)
               (let ((sum (funcall number 0)))
                 (loop for j from from to to do (setq sum (operate :add sum (funcall term j))))
                 sum))
             (products (from to a b) (sum from to (lambda (j) (operate :multiply (at a j) (at b (- k j))))))
             (weighted (from to a b)
               (sum from to (lambda (j) (times j (operate :multiply (at a j) (at b (- k j)))))))
             (half (x) (over x 2)))
      (ecase operation
        ((:add :subtract) (operate operation (at a k) (at b k)))
        (:negate (operate :negate (at a k)))
        (:shift (if (zerop k) (operate :add (at a 0) (constant b)) (at a k)))
        (:scale (operate :multiply (at a k) (constant b)))
        (:over (operate :divide (at a k) (constant b)))
        (:fixed (if (zerop k) (constant a) (funcall number 0)))
        (:multiply (products 0 k a b))
        (:square (products 0 k a a))
        (:divide (operate :divide (operate :subtract (at a k) (products 1 k b place)) (at b 0)))
        (:reciprocal (operate :divide
                              (if (zerop k) (constant b) (operate :negate (products 1 k a place)))
                              (at a 0)))
        (:sqrt (if (zerop k)
                   (operate :sqrt (at a 0))
                   (operate :divide (operate :subtract (at a k) (products 1 (1- k) place place))
                            (times 2 (at place 0)))))
        (:power (if (zerop k)
                    (operate :expt (at a 0) (constant b))
                    (operate :divide
                             (sum 0 (1- k)
                                  (lambda (j)
                                    (operate :multiply
                                             (operate :subtract (times (- k j) (constant b)) (funcall number j))
                                             (operate :multiply (at a (- k j)) (at place j)))))
                             (times k (at a 0)))))
        (:primitive (if (zerop k)
                        (operate a (at b 0))
                        (over (times d (weighted 1 k b c)) k)))
        (:primitive-over (if (zerop k)
                             (operate a (at b 0))
                             (operate :divide
                                      (operate :subtract (times (* d k) (at b k)) (weighted 1 (1- k) place c))
                                      (times k (at c 0)))))
        (:angle (if (zerop k)
                    (operate :atan2 (at a 0) (at b 0))
                    (operate :divide
                             (operate :subtract
                                      (operate :subtract (weighted 1 k a b) (weighted 1 k b a))
                                      (weighted 1 (1- k) place c))
                             (times k (at c 0)))))
        (:absolute (operate :multiply (operate :signum (at a 0)) (at a k)))
        (:sign (if (zerop k) (operate :signum (at a 0)) (funcall number 0)))
        (:floor (if (zerop k) (operate :floor (at a 0)) (funcall number 0)))
        ((:larger :smaller)
         (let ((sign (operate :signum (operate :subtract (at a 0) (at b 0)))))
           (half (operate (if (eq operation :larger) :add :subtract)
                          (operate :add (at a k) (at b k))
                          (operate :multiply sign (operate :subtract (at a k) (at b k)))))))))))

(defun inverted-matrix (linear row operate number)
  "The inverse of A[0], a list of rows, by elimination with the first pivot that is not zero."
  (let* ((size (linear-series-size linear))
         (rows (make-array size)))
    (dotimes (i size)
      (setf (aref rows i) (make-array (* 2 size) :initial-element (funcall number 0))
            (aref (aref rows i) (+ size i)) (funcall number 1)))
    (loop for (i j operand) in (linear-series-entries linear)
          do (setf (aref (aref rows i) j) (funcall row operand 0)))
    (flet ((inverse (x) (handler-case (funcall operate :divide (funcall number 1) x)
                          ((or domain-violation arithmetic-error) () nil))))
      (dotimes (k size)
        (let* ((at (or (loop for i from k below size when (inverse (aref (aref rows i) k)) return i)
                       (error 'domain-violation :operation :solve :source nil)))
               (inverse (inverse (aref (aref rows at) k))))
          (rotatef (aref rows k) (aref rows at))
          (setf (aref rows k) (map 'vector (lambda (x) (funcall operate :multiply inverse x)) (aref rows k)))
          (dotimes (i size)
            (unless (= i k)
              (let ((part (aref (aref rows i) k)))
                (setf (aref rows i)
                      (map 'vector (lambda (x y) (funcall operate :subtract x (funcall operate :multiply part y)))
                           (aref rows i) (aref rows k)))))))))
    (map 'vector (lambda (line) (subseq line size)) rows)))

(defun unknown-coefficients (linear k inverse row unknowns operate number)
  "Those of order K."
  (let ((right (map 'vector (lambda (operand) (funcall row operand k)) (linear-series-rights linear))))
    (loop for (i column operand) in (linear-series-entries linear)
          do (when (integerp operand)
               (loop for j from 1 to k
                     do (setf (aref right i)
                              (funcall operate :subtract (aref right i)
                                       (funcall operate :multiply (funcall row operand j)
                                                (aref (aref unknowns (- k j)) column)))))))
    (map 'vector
         (lambda (line)
           (let ((sum (funcall number 0)))
             (loop for x across line for y across right
                   do (setq sum (funcall operate :add sum (funcall operate :multiply x y))))
             sum))
         inverse)))
