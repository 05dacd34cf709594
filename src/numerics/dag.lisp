;;; anmech: expressions as a directed graph in which every subexpression occurs once.
;;;
;;; Maxima expressions come in through TERM-OF; what comes out are terms, pairs (vertex . coefficient) with a rational
;;; coefficient (a float is taken for the rational number that it is, so that nothing is rounded before the end).
;;; Keeping the coefficient outside of the vertex makes a sign free and lets a - b and b - a, x + y and 2*x + 2*y share
;;; one vertex. Sums and products are n-ary and flat: a sum is a list of terms, a product a list of factors
;;; (vertex . integer exponent), both in the order of the vertices, so that equal ones are found by hashing.
;;;
;;; Entry points: WITH-GRAPH, DECLARE-INPUT, TERM-OF; SUM, PRODUCT, INTEGER-POWER, APPLY-FUNCTION; TO-DOUBLE;
;;; *CONSTANTS*, *ROUND-CONSTANTS*, *ROOTS-OF-POWERS*; the condition UNSUPPORTED-EXPRESSION.
;;;
;;; Literature: A. V. Aho, R. Sethi, J. D. Ullman, Compilers, 1986, 5.2 (construction of dags).

(in-package :anmech)
(needs "session/texts" "algebra/kinks" "algebra/rootsums" "numerics/operations")

(define-condition unsupported-expression (error)
  ((sentence :initarg :sentence :reader unsupported-sentence))
  (:report (lambda (condition stream) (write-string (unsupported-sentence condition) stream))))

(defun unsupported (format expression)
  (error 'unsupported-expression :sentence (format nil format (maxima-text expression))))

(defun with-compilation-errors (thunk)
  (handler-case (funcall thunk)
    (unsupported-expression (condition) (complain "~a" (unsupported-sentence condition)))))

;;; Vertices

(defstruct (vertex (:print-function print-vertex))
  (kind nil :read-only t)          ; :one, :input, :sum, :product, :unit or the name of a function
  (operands nil)                   ; terms; factors of a product
  (number 0 :type fixnum)          ; in the order of creation: operands before what is made of them
  (source nil)                     ; the expression it came from, for messages
  (above 0 :type fixnum)           ; counters of later passes: occurrences with positive exponents
  (below 0 :type fixnum)           ; and with negative ones
  (value nil))                     ; the operand that holds it in a program

(defun print-vertex (vertex stream depth)
  (declare (ignore depth))
  (format stream "#<vertex ~a ~a>" (vertex-number vertex) (vertex-kind vertex)))

(defvar *vertex-table* nil "From hash values to lists of vertices.")
(defvar *vertex-count* 0)
(defvar *one* nil "The vertex of the number 1: a constant is a term of it.")
(defvar *inputs* nil "From variables to their vertices.")
(defvar *converted* nil "From expressions (by identity) to their terms: derivatives share much of their structure.")

(defmacro with-graph (&body body)
  "An empty graph while BODY runs."
  `(let* ((*vertex-table* (make-hash-table))
          (*vertex-count* 0)
          (*one* (intern-vertex :one '()))
          (*inputs* (make-hash-table :test 'equal))
          (*converted* (make-hash-table :test 'eq)))
     ,@body))

(defun operands-hash (kind operands)
  (let ((hash (logand (sxhash kind) #xFFFFFF)))
    (declare (fixnum hash))
    (dolist (pair operands hash)
      (setq hash (logand (the fixnum (+ (the fixnum (* hash 31)) (the fixnum (* 7 (vertex-number (car pair))))
                                        (the fixnum (logand (sxhash (cdr pair)) #xFFFFFF))))
                         #xFFFFFF)))))

(defun same-operands (first second)
  (loop (cond ((null first) (return (null second)))
              ((null second) (return nil))
              ((not (and (eq (caar first) (caar second)) (eql (cdar first) (cdar second)))) (return nil)))
        (pop first)
        (pop second)))

(defun intern-vertex (kind operands)
  "The vertex of this KIND and these OPERANDS, made if there is none yet."
  (let ((hash (operands-hash kind operands)))
    (dolist (vertex (gethash hash *vertex-table*))
      (when (and (eq kind (vertex-kind vertex)) (same-operands operands (vertex-operands vertex)))
        (return-from intern-vertex vertex)))
    (let ((vertex (make-vertex :kind kind :operands operands :number (incf *vertex-count*))))
      (push vertex (gethash hash *vertex-table*))
      vertex)))

;;; Terms

(defun constant (number) (cons *one* number))
(defun constant-p (term) (eq (car term) *one*))
(defun zero-p (term) (eql 0 (cdr term)))

(defun factors (vertex)
  "VERTEX as a product."
  (case (vertex-kind vertex)
    (:product (vertex-operands vertex))
    (:one '())
    (t (list (cons vertex 1)))))

(defun collect (pairs)
  "PAIRS (vertex . number) in the order of their vertices, the numbers of equal vertices added, without zeros."
  (let ((result '()))
    (dolist (pair (sort (copy-list pairs) #'> :key (lambda (pair) (vertex-number (car pair)))))
      (if (and result (eq (car pair) (car (first result))))
          (setf (first result) (cons (car pair) (+ (cdr pair) (cdr (first result)))))
          (push pair result)))
    (delete-if #'zero-p result)))

(defun product-of-factors (coefficient factors)
  "The term COEFFICIENT times the product of FACTORS, which may be products themselves."
  (let* ((flat (mapcan (lambda (factor)
                         (mapcar (lambda (inner) (cons (car inner) (* (cdr inner) (cdr factor))))
                                 (factors (car factor))))
                       factors))
         (factors (collect flat)))
    (cond ((null factors) (constant coefficient))
          ((and (null (rest factors)) (= 1 (cdr (first factors)))) (cons (car (first factors)) coefficient))
          (t (cons (intern-vertex :product factors) coefficient)))))

(defun product (terms)
  (let ((coefficient 1) (factors '()))
    (dolist (term terms)
      (setq coefficient (* coefficient (cdr term)))
      (unless (constant-p term) (push (cons (car term) 1) factors)))
    (if (zerop coefficient)
        (constant 0)
        (product-of-factors coefficient factors))))

(defun scaled (term factor)
  (cons (car term) (* factor (cdr term))))

(defun sum (terms)
  (let ((terms (merged (collect terms))))
    (if (rest terms)
        (plain-sum terms)
        (or (first terms) (constant 0)))))

(defun merged (terms)
  "TERMS with sums among them opened, and with terms of equal cofactor of a sum united: C*(a+b) - C*(b+c) is C*(a-c)."
  (let ((groups '()) (change nil))         ; of (cofactor (sum . coefficient) ...)
    (dolist (term terms)
      (multiple-value-bind (sum cofactor) (sum-and-cofactor (car term))
        (when sum
          (let ((group (assoc cofactor groups :test #'eq)) (item (cons sum (cdr term))))
            (when (or group (eq cofactor *one*)) (setq change t))
            (if group (push item (cdr group)) (push (list cofactor item) groups))))))
    (if (not change)
        terms
        (let ((result (remove-if (lambda (term) (sum-and-cofactor (car term))) terms)))
          (loop for (cofactor . items) in groups
                for opened = (loop for (sum . coefficient) in items
                                   append (mapcar (lambda (term) (scaled term coefficient)) (vertex-operands sum)))
                do (cond ((eq cofactor *one*) (setq result (append opened result)))
                         ((rest items) (push (product (list (cons cofactor 1) (sum opened))) result))
                         (t (push (product (list (cons cofactor 1) (first items))) result))))
          (merged (collect result))))))

(defun sum-and-cofactor (vertex)
  "The sum S and the vertex C if VERTEX is C*S, where C has no sum to the first power as a factor."
  (case (vertex-kind vertex)
    (:sum (values vertex *one*))
    (:product (let ((sums (remove-if-not (lambda (factor)
                                           (and (eq :sum (vertex-kind (car factor))) (eql 1 (cdr factor))))
                                         (vertex-operands vertex))))
                (when (and sums (null (rest sums)))
                  (values (car (first sums))
                          (car (product-of-factors 1 (remove (first sums) (vertex-operands vertex) :test #'eq)))))))))

(defun plain-sum (terms)
  "TERMS, two at least, as a vertex with positive leading coefficient times a number."
  (let* ((content (content terms))
         (scale (if (minusp (cdr (first terms))) (- content) content)))
    (cons (intern-vertex :sum (if (eql scale 1) terms (mapcar (lambda (term) (scaled term (/ scale))) terms)))
          scale)))

(defun content (terms)
  "A positive coefficient of TERMS that divides all others and costs no multiplication to take out; 1 if none."
  (let ((unequal (count-if-not (lambda (term) (eql 1 (abs (cdr term)))) terms)))
    (flet ((divides-p (candidate)
             (let ((left 1))
               (dolist (term terms (<= left unequal))
                 (let ((size (abs (cdr term))))
                   (cond ((eql size candidate))
                         ((integerp (/ size candidate)) (incf left))
                         (t (return nil))))))))
      (dolist (term terms 1)
        (let ((candidate (abs (cdr term))))
          (when (divides-p candidate) (return candidate)))))))

;;; Powers

(defun integer-power (term exponent)
  (destructuring-bind (vertex . coefficient) term
    (cond ((zerop exponent) (constant 1))
          ((and (zerop coefficient) (plusp exponent)) (constant 0))
          ((zerop coefficient) (error 'unsupported-expression :sentence "a denominator is identically zero"))
          ((<= (* (abs exponent) (bits coefficient)) 4000)
           (product-of-factors (expt coefficient exponent) (list (cons vertex exponent))))
          (t (product-of-factors 1 (list (cons (as-vertex term) exponent)))))))

(defun bits (number)
  "The size of NUMBER, 0 for 1 and -1."
  (if (eql 1 (abs number)) 0 (max (integer-length (numerator number)) (integer-length (denominator number)))))

(defun as-vertex (term)
  "A vertex with the value of TERM."
  (if (eql 1 (cdr term)) (car term) (intern-vertex :sum (list term))))

(defvar *roots-of-powers* t
  "Whether u^(3/2) is u sqrt(u), which costs less; the derivative of that has no value where u vanishes.")

(defun power (base exponent source)
  "BASE to the EXPONENT, two terms; SOURCE is the expression they came from."
  (let ((number (and (constant-p exponent) (cdr exponent))))
    (cond ((integerp number) (integer-power base number))
          ((and number (= 2 (denominator number)) (or *roots-of-powers* (< number 1)))
           (let ((root (apply-function :sqrt (list base) source)))
             (multiple-value-bind (whole half) (truncate number)
               (product (list (integer-power base whole)
                              (if (plusp half) root (integer-power root -1)))))))
          (t (apply-function :expt (list base exponent) source)))))

;;; Functions

(defparameter *functions*
  ;; name, number of arguments, parity; sums, products and powers are not among them
  '((:exp 1) (:log 1) (:sqrt 1) (:expt 2) (:sin 1 :odd) (:cos 1 :even) (:tan 1 :odd) (:asin 1 :odd) (:acos 1)
    (:atan 1 :odd) (:atan2 2) (:sinh 1 :odd) (:cosh 1 :even) (:tanh 1 :odd) (:asinh 1 :odd) (:acosh 1) (:atanh 1 :odd)
    (:erf 1 :odd) (:erfc 1) (:abs 1 :even) (:signum 1 :odd) (:floor 1) (:max 2) (:min 2)))

(defvar *round-constants* t
  "Whether a function of numbers is computed at once, as a double, and %pi is a number.  If not, they are left to who
runs the program, with numbers of any precision.")

(defun apply-function (name terms source)
  "The term of the function NAME of TERMS; SOURCE is the expression it came from."
  (if (and *round-constants* (every #'constant-p terms))
      (constant (to-rational (or (constant-value name (mapcar (lambda (term) (to-double (cdr term))) terms))
                                 (unsupported "~a has no finite real value" source))
                             source))
      (let* ((parity (third (assoc name *functions*)))
             (negative (and parity (minusp (cdr (first terms)))))
             (terms (if negative (list (cons (car (first terms)) (- (cdr (first terms))))) terms))
             (vertex (intern-vertex name terms)))
        (unless (vertex-source vertex) (setf (vertex-source vertex) source))
        (cons vertex (if (and negative (eq parity :odd)) -1 1)))))

;;; Numbers

(defun to-double (number)
  "The double next to the rational NUMBER. Lisp's own conversion overflows for ratios of huge integers on GCL."
  (if (minusp number) (- (positive-to-double (- number))) (positive-to-double number)))

(defun to-rational (number source)
  "The exact value of the float NUMBER, which stands in the expression SOURCE."
  (let ((number (float number 1d0)))
    (unless (<= (abs number) most-positive-double-float) (unsupported "~a is not a finite number" source))
    (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
      (* sign mantissa (expt 2 exponent)))))

(defun positive-to-double (number)
  (if (zerop number)
      0d0
      (let* ((above (numerator number))
             (below (denominator number))
             ;; 53 bits of the quotient, fewer where the result is denormalized
             (shift (max (- (integer-length above) (integer-length below) 53) -1074))
             (mantissa (if (minusp shift)
                           (round (ash above (- shift)) below)
                           (round above (ash below shift)))))
        (when (> (integer-length mantissa) 53)
          (incf shift)
          (setq mantissa (if (minusp shift)
                             (round (ash above (- shift)) below)
                             (round above (ash below shift)))))
        (when (> (+ (integer-length mantissa) shift) 1024)
          (unsupported "the number ~a is too large for a double" (from-rational number)))
        (scaled-double mantissa shift))))

(defun scaled-double (mantissa shift)
  "MANTISSA, an integer of at most 53 bits, times 2^SHIFT."
  (let ((value (coerce mantissa 'double-float)))
    (loop while (< shift -1000) do (setq value (* value (expt 2d0 -500)) shift (+ shift 500)))
    (loop while (> shift 900) do (setq value (* value (expt 2d0 50)) shift (- shift 50)))
    (* value (expt 2d0 shift))))

(defun from-rational (number)
  (if (integerp number) number (list '(maxima::rat maxima::simp) (numerator number) (denominator number))))

(defparameter *least-binary* -100000 "What is smaller than such a power of two vanishes.")

(defun bigfloat-value (expression &optional (most 1100))
  "A bigfloat as an exact number; ((bigfloat simp precision) mantissa exponent) is mantissa*2^(exponent - precision).
MOST is nil, or the binary logarithm of what is too large."
  (destructuring-bind ((name &rest flags) mantissa exponent) expression
    (declare (ignore name))
    (let* ((shift (- exponent (first (last flags)))) (size (+ (integer-length mantissa) shift)))
      (cond ((zerop mantissa) 0)
            ((and most (> size most)) (unsupported "the number ~a is too large for a double" expression))
            ((< size *least-binary*) 0)
            (t (* mantissa (expt 2 shift)))))))

(defparameter *constants*
  '((maxima::$%pi . 314159265358979323846264338327950288/100000000000000000000000000000000000)
    (maxima::$%e . 271828182845904523536028747135266250/100000000000000000000000000000000000)
    (maxima::$%phi . 161803398874989484820458683436563812/100000000000000000000000000000000000)
    (maxima::$%gamma . 57721566490153286060651209008240243/100000000000000000000000000000000000)))

;;; Conversion

(defun plain-form (expression)
  "EXPRESSION without the marks of the simplifier, for comparison."
  (if (atom expression)
      expression
      (cons (cons (caar expression) (and (member 'maxima::array (cdar expression)) '(maxima::array)))
            (mapcar #'plain-form (rest expression)))))

(defun declare-input (variable)
  "A new vertex for VARIABLE, a symbol or a subscripted variable."
  (setf (gethash (plain-form variable) *inputs*)
        (make-vertex :kind :input :number (incf *vertex-count*) :source variable)))

(defun declare-constant (name)
  "A new vertex for a constant that is known by its NAME only: an input that nobody has to give."
  (let ((vertex (declare-input name)))
    (setf (vertex-value vertex) (cons :constant name))
    vertex))

(defun term-of (expression)
  "The term of a Maxima expression in the declared inputs."
  (if (atom expression)
      (atom-term expression)
      (or (gethash expression *converted*)
          (setf (gethash expression *converted*) (compound-term expression)))))

(defun atom-term (atom)
  (if (numberp atom)
      (constant (if (rationalp atom) atom (to-rational atom atom)))
      (let ((input (gethash atom *inputs*))
            (known (assoc atom *constants*)))
        (cond (input (cons input 1))
              ((and known *round-constants*) (constant (cdr known)))
              (known (cons (declare-constant atom) 1))
              (t (unsupported "~a is neither a variable nor a parameter" atom))))))

(defun compound-term (expression)
  (let ((arguments (rest expression)))
    (case (caar expression)
      (maxima::mplus (sum (mapcar #'term-of arguments)))
      (maxima::mtimes (product (mapcar #'term-of arguments)))
      (maxima::mexpt (power-term expression (first arguments) (second arguments)))
      (maxima::mminus (product (list (constant -1) (term-of (first arguments)))))
      (maxima::mquotient (product (list (term-of (first arguments)) (reciprocal (second arguments)))))
      (maxima::rat (constant (/ (first arguments) (second arguments))))
      (maxima::bigfloat (constant (bigfloat-value expression)))
      (t (function-term expression)))))

(defun reciprocal (expression)
  (let ((term (term-of expression)))
    (unless (vertex-source (car term)) (setf (vertex-source (car term)) expression))
    (integer-power term -1)))

(defun power-term (source base exponent)
  (let ((exponent (term-of exponent)))
    (if (eq base 'maxima::$%e)
        (apply-function :exp (list exponent) source)
        (let ((base-term (term-of base)))
          (when (and (constant-p exponent) (minusp (cdr exponent)))
            (unless (vertex-source (car base-term)) (setf (vertex-source (car base-term)) base)))
          (power base-term exponent source)))))

(defparameter *reciprocals*
  '((:sec maxima::%cos) (:csc maxima::%sin) (:cot maxima::%tan) (:sech maxima::%cosh) (:csch maxima::%sinh)
    (:coth maxima::%tanh)))

(defparameter *of-reciprocals*
  ;; as Maxima has it: acot jumps at 0
  '((:asec . :acos) (:acsc . :asin) (:acot . :atan) (:asech . :acosh) (:acsch . :asinh) (:acoth . :atanh)))

(defun function-term (expression)
  (let* ((name (function-name (caar expression)))
         (arguments (rest expression))
         (entry (assoc name *functions*))
         (reciprocal (and (null (rest arguments)) (second (assoc name *reciprocals*))))
         (of-reciprocal (and (null (rest arguments)) (cdr (assoc name *of-reciprocals*)))))
    (cond ((and entry (= (length arguments) (second entry)))
           (apply-function name (mapcar #'term-of arguments) expression))
          ((and (member name '(:max :min)) arguments)
           (reduce (lambda (first second) (apply-function name (list first second) expression))
                   (mapcar #'term-of arguments)))
          (reciprocal (reciprocal (list (list reciprocal) (first arguments))))
          (of-reciprocal (apply-function of-reciprocal (list (reciprocal (first arguments))) expression))
          ((member name '(:ceiling :round :truncate :mod)) (by-floor name (mapcar #'term-of arguments) expression))
          ((and (member (caar expression) *written-by-signs*) (written-by-signs expression)))
          ((root-sum-p expression)
           (term-of (or (root-sum-written-out expression)
                        (unsupported "the roots of ~a are wanted as numbers: put the values of its parameters into ~
                                      the system first"
                                     (root-polynomial expression)))))
          ((number-in-double expression))
          (t (input-term expression)))))

(defun number-in-double (expression)
  "The term of a function of numbers that no program has, such as zeta(3); nil if it is none, or if not doubles are
wanted, but any precision."
  (when (and *round-constants* (maxima::$constantp expression))
    (let ((value (maxima::mfuncall 'maxima::$float expression)))
      (and (floatp value) (constant (to-rational value expression))))))

(defun by-floor (name terms source)
  "The term of a relative of floor; halves are rounded up."
  (destructuring-bind (u &optional v) terms
    (flet ((whole (term) (apply-function :floor (list term) source))
           (times (a b) (product (list a b))))
      (ecase name
        (:ceiling (scaled (whole (scaled u -1)) -1))
        (:round (whole (sum (list u (constant 1/2)))))
        (:truncate (times (apply-function :signum (list u) source) (whole (apply-function :abs (list u) source))))
        (:mod (sum (list u (scaled (times v (whole (times u (integer-power v -1)))) -1))))))))

(defun written-by-signs (expression)
  "The term of a conditional or the like; nil if it has no such form."
  (let ((written (by-signs expression)))
    (and (consp written) (not (member (caar written) *written-by-signs*)) (term-of written))))

(defun input-term (expression)
  "The term of a subscripted variable, or of whatever else was declared."
  (let ((input (gethash (plain-form expression) *inputs*)))
    (cond (input (cons input 1))
          ((member 'maxima::array (cdar expression))
           (unsupported "~a is neither a variable nor a parameter" expression))
          (t (unsupported "the function ~a cannot be compiled" expression)))))

(defun function-name (operator)
  "The keyword of a Maxima function, verb or noun: %sin and $sin give :sin."
  (let ((name (symbol-name operator)))
    (cond ((eq operator 'maxima::mabs) :abs)
          ((and (> (length name) 1) (find (char name 0) "$%")) (find-symbol (subseq name 1) :keyword))
          (t nil))))
