;;; anmech: straight-line programs as statements of C, Fortran, Julia and Python.
;;;
;;; A LANGUAGE tells how it writes numbers, elements of arrays, operations and comments.  What is used once stands where
;;; it is used, as long as lines stay short; what is used more often has a name of its own.  Parentheses keep the order
;;; of the operations that the kernel's own code has.
;;;
;;; Entry points: LANGUAGE and its readers, LANGUAGE-NAMED, WITH-PREFIXED-SIGN, NAMES-CALLED, TIDIED-PROGRAM,
;;; PROGRAM-STATEMENTS, IDENTIFIERS, COMMENT-LINES.

(in-package :anmech)
(needs "session/scripts" "session/texts" "numerics/dag" "numerics/sharing")

(defstruct language
  name
  suffixes          ; of files
  base              ; the index of the first element of an array
  element           ; format control of array and index; of two indices, where arrays have them
  pair              ; the same of two indices; nil: rows follow one another in one array
  field             ; format control of a parameter's name
  scratch           ; format control of the number of an intermediate result
  declaration       ; format control of its statement, of name and expression
  assignment        ; the same for what is declared already
  exponent          ; the letter of powers of ten in numbers
  functions         ; operation -> format control of its operands
  comment           ; what a line of comment begins with
  words             ; that no name may be
  called)           ; functions and types that are used beside FUNCTIONS: no module may have such a name

(defparameter *common-functions*
  '((:sin "sin(~a)") (:cos "cos(~a)") (:tan "tan(~a)") (:exp "exp(~a)") (:log "log(~a)") (:sqrt "sqrt(~a)")
    (:asin "asin(~a)") (:acos "acos(~a)") (:atan "atan(~a)") (:sinh "sinh(~a)") (:cosh "cosh(~a)") (:tanh "tanh(~a)")
    (:asinh "asinh(~a)") (:acosh "acosh(~a)") (:atanh "atanh(~a)") (:atan2 "atan2(~a, ~a)") (:abs "abs(~a)")
    (:erf "erf(~a)") (:erfc "erfc(~a)")
    (:signum "sign_of(~a)") (:floor "floor(~a)") (:max "max(~a, ~a)") (:min "min(~a, ~a)") (:expt "(~a**~a)")))

(defun functions-with (changes)
  (append changes (remove-if (lambda (entry) (assoc (first entry) changes)) *common-functions*)))

(defun words-of (text) (split-words-at-spaces (substitute #\Space #\Newline text)))

(defun split-words-at-spaces (text)
  (loop with start = 0
        for end = (position #\Space text :start start)
        unless (eql start (or end (length text))) collect (subseq text start end)
        while end do (setq start (1+ end))))

(defun names-with (stems endings)
  (loop for stem in stems append (loop for ending in endings collect (concatenate 'string stem ending))))

(defparameter *c-macros*
  (append
   (names-with (words-of "M_E M_LOG2E M_LOG10E M_LN2 M_LN10 M_PI M_PI_2 M_PI_4 M_1_PI M_2_PI M_2_SQRTPI M_SQRT2
 M_SQRT1_2")
               '("" "f" "l" "f16" "f32" "f64" "f128" "f32x" "f64x"))
   (names-with '("HUGE_VAL") '("" "F" "L" "_F16" "_F32" "_F64" "_F128" "_F32X" "_F64X"))
   (names-with '("SNAN") '("" "F" "L" "F16" "F32" "F64" "F128" "F32X" "F64X"))
   (names-with '("FLT" "DBL" "LDBL")
               (words-of "_DIG _DECIMAL_DIG _EPSILON _HAS_SUBNORM _MANT_DIG _MAX _MAX_10_EXP _MAX_EXP _MIN _MIN_10_EXP
 _MIN_EXP _TRUE_MIN _NORM_MAX _IS_IEC_60559 _SNAN"))
   (words-of "INFINITY NAN FP_NAN FP_INFINITE FP_NORMAL FP_SUBNORMAL FP_ZERO FP_ILOGB0 FP_ILOGBNAN FP_LLOGB0 FP_LLOGBNAN
 FP_FAST_FMA FP_FAST_FMAF FP_FAST_FMAL FP_INT_UPWARD FP_INT_DOWNWARD FP_INT_TOWARDZERO FP_INT_TONEARESTFROMZERO
 FP_INT_TONEAREST MATH_ERRNO MATH_ERREXCEPT math_errhandling MAXFLOAT HUGE X_TLOSS DOMAIN SING OVERFLOW UNDERFLOW TLOSS
 PLOSS FLT_EVAL_METHOD FLT_RADIX FLT_ROUNDS DECIMAL_DIG CR_DECIMAL_DIG NULL EOF EXIT_SUCCESS EXIT_FAILURE
 RAND_MAX MB_CUR_MAX WNOHANG WUNTRACED WSTOPPED WEXITED WCONTINUED WNOWAIT BIG_ENDIAN LITTLE_ENDIAN PDP_ENDIAN
 BYTE_ORDER FD_SETSIZE NFDBITS BUFSIZ errno stdin stdout stderr complex imaginary i386"))
  "Object-like macros of math.h, float.h and stdlib.h of C99 and GNU, and what is often included with them: they would
be replaced also as names of fields.")

(defparameter *languages*
  (list
   (make-language
    :name 'maxima::$c :suffixes '("c" "h") :base 0 :element "~a[~d]" :field "p->~a" :scratch "s~d"
    :declaration "  const double ~a = ~a;" :assignment "  ~a = ~a;" :exponent "e" :comment " *"
    :functions (functions-with '((:abs "fabs(~a)") (:max "fmax(~a, ~a)") (:min "fmin(~a, ~a)")
                                 (:expt "pow(~a, ~a)")))
    :words (append *c-macros* (words-of "auto break case char const continue default do double else enum extern
 float for goto if inline int long register restrict return short signed sizeof static struct switch typedef union
 unsigned void volatile while bool true false I asm typeof linux unix class new delete this template namespace using
 public private protected virtual friend operator try catch throw and or not xor")))
   (make-language
    :name 'maxima::$fortran :suffixes '("f90" "f95" "f03" "f08") :base 1 :element "~a(~d)" :pair "~a(~d, ~d)"
    :field "p%~a" :scratch "s(~d)" :declaration "    ~a = ~a" :assignment "    ~a = ~a" :exponent "d" :comment "!"
    :functions (functions-with '((:floor "(~a - modulo(~:*~a, 1d0))")))         ; its floor is an integer
    :words (words-of "kind len")         ; components have a name space of their own
    :called (words-of "kind real maxloc"))
   (make-language
    :name 'maxima::$julia :suffixes '("jl") :base 1 :element "~a[~d]" :pair "~a[~d, ~d]" :field "p.~a"
    :scratch "s~d" :declaration "    ~a = ~a" :assignment "    ~a = ~a" :exponent "e" :comment "#"
    :functions (functions-with '((:atan2 "atan(~a, ~a)") (:signum "sign(~a)") (:expt "(~a^~a)")
                                 (:erf "ccall((:erf, Base.Math.libm), Float64, (Float64,), ~a)")
                                 (:erfc "ccall((:erfc, Base.Math.libm), Float64, (Float64,), ~a)")))
    :words (words-of "baremodule begin break catch const continue do else elseif end export false finally for function
 global if import let local macro module quote return struct true try using while where in isa mutable abstract
 primitive type outer")
    :called (words-of "Base Float64 ccall zeros eltype fill"))
   (make-language
    :name 'maxima::$python :suffixes '("py") :base 0 :element "~a[~d]" :pair "~a[~d, ~d]" :field "p.~a"
    :scratch "s~d" :declaration "    ~a = ~a" :assignment "    ~a = ~a" :exponent "e" :comment "#"
    :functions (append '((:asin "np.arcsin(~a)") (:acos "np.arccos(~a)") (:atan "np.arctan(~a)")
                         (:asinh "np.arcsinh(~a)") (:acosh "np.arccosh(~a)") (:atanh "np.arctanh(~a)")
                         (:atan2 "np.arctan2(~a, ~a)") (:signum "np.sign(~a)") (:max "np.maximum(~a, ~a)")
                         (:min "np.minimum(~a, ~a)") (:expt "np.power(~a, ~a)")
                         (:erf "np.vectorize(math.erf)(~a)") (:erfc "np.vectorize(math.erfc)(~a)"))
                       (mapcar (lambda (entry) (list (first entry) (concatenate 'string "np." (second entry))))
                               *common-functions*))
    :words (words-of "False None True and as assert async await break class continue def del elif else except finally
 for from global if import in is lambda nonlocal not or pass raise return try while with yield match case type
 print self"))))

(defun language-named (name)
  (or (find-if (lambda (language) (string-equal (symbol-name name) (symbol-name (language-name language)))) *languages*)
      (complain "expected one of the languages c, fortran, julia, python, found ~a" (one-line name))))

;;; Functions and their names

(defun with-prefixed-sign (language prefix)
  "LANGUAGE, whose function for signs begins with PREFIX: in C all functions of a program share one space of names."
  (let ((changed (copy-language language)))
    (setf (language-functions changed)
          (cons (list :signum (format nil "~a_sign_of(~~a)" prefix)) (language-functions language)))
    changed))

(defun names-called (language)
  "The functions that a program may call, and other words between their operands."
  (append (language-called language)
          (loop for (nil control) in (language-functions language)
                append (words-of (substitute-if #\Space (lambda (char) (not (or (alphanumericp char) (char= char #\_))))
                                                control)))))

;;; Numbers and elements

(defun foreign-number (rational language)
  "A number, to the last bit of the double next to it; a double in every language, so that 1/2 is not 0."
  (let ((number (to-double rational)))
    (cond ((zerop number) (foreign-digits "0.0" "" language))
          (t (multiple-value-bind (m e) (decimal-parts (abs number))
               (let* ((digits (format nil "~d" m)) (power (+ e (length digits) -1))
                      (text (if (< -4 power 7)
                                (foreign-digits (plain-decimal digits power) "" language)
                                (foreign-digits (format nil "~a.~a" (char digits 0)
                                                        (if (string= "" (subseq digits 1)) "0" (subseq digits 1)))
                                                (format nil "~d" power) language))))
                 (if (minusp number) (format nil "(-~a)" text) text)))))))

(defun plain-decimal (digits power)
  "The number d.ddd*10^POWER of DIGITS without a power."
  (flet ((zeros (count) (make-string (max 0 count) :initial-element #\0)))
    (if (minusp power)
        (format nil "0.~a~a" (zeros (- -1 power)) digits)
        (let ((padded (concatenate 'string digits (zeros (- (+ power 2) (length digits))))))
          (format nil "~a.~a" (subseq padded 0 (1+ power)) (subseq padded (1+ power)))))))

(defun foreign-digits (mantissa power language)
  (let ((letter (language-exponent language)))
    (cond ((string/= power "") (format nil "~a~a~a" mantissa letter power))
          ((string= letter "d") (format nil "~ad0" mantissa))
          (t mantissa))))

(defun element-text (language array row &optional column (columns 1))
  "An element, rows and columns counted from 0."
  (let ((base (language-base language)))
    (cond ((null column) (format nil (language-element language) array (+ row base)))
          ((language-pair language) (format nil (language-pair language) array (+ row base) (+ column base)))
          (t (format nil (language-element language) array (+ column (* columns row)))))))

;;; Derivatives of programs are full of products with 1 and -1

(defun tidied-program (program)
  "PROGRAM without operations on numbers alone, products with 1, -1 and 0, and signs that cancel."
  (let ((code (make-array 64 :adjustable t :fill-pointer 0)) (known (make-hash-table :test 'equal))
        (images (make-array (length (program-instructions program)))))
    (labels ((image (operand) (if (integerp operand) (aref images operand) operand))
             (number (operand) (and (consp operand) (eq :number (car operand)) (cdr operand)))
             (negated (operand) (and (integerp operand) (eq :negate (first (aref code operand)))
                                     (second (aref code operand))))
             (put (operation a &optional b)
               (let ((instruction (list* operation a (and b (list b)))))
                 (or (gethash instruction known)
                     (setf (gethash instruction known) (vector-push-extend instruction code)))))
             (minus (a)
               (cond ((number a) (cons :number (- (number a))))
                     ((negated a))
                     (t (put :negate a))))
             (sum (a b)
               (cond ((and (number a) (number b)) (cons :number (+ (number a) (number b))))
                     ((eql 0 (number a)) b)
                     ((eql 0 (number b)) a)
                     ((negated b) (difference a (negated b)))
                     ((negated a) (difference b (negated a)))
                     (t (put :add a b))))
             (difference (a b)
               (cond ((and (number a) (number b)) (cons :number (- (number a) (number b))))
                     ((eql 0 (number b)) a)
                     ((eql 0 (number a)) (minus b))
                     ((negated b) (sum a (negated b)))
                     ((negated a) (minus (sum (negated a) b)))
                     (t (put :subtract a b))))
             (times (a b)
               (cond ((and (number a) (number b)) (cons :number (* (number a) (number b))))
                     ((or (eql 0 (number a)) (eql 0 (number b))) '(:number . 0))
                     ((eql 1 (number a)) b)
                     ((eql 1 (number b)) a)
                     ((eql -1 (number a)) (minus b))
                     ((eql -1 (number b)) (minus a))
                     ((negated a) (minus (times (negated a) b)))
                     ((negated b) (minus (times a (negated b))))
                     (t (put :multiply a b))))
             (operation (name a b)
               (case name
                 (:add (sum a b))
                 (:subtract (difference a b))
                 (:multiply (times a b))
                 (:negate (minus a))
                 (:divide (cond ((eql 1 (number b)) a)
                                ((negated a) (minus (put :divide (negated a) b)))
                                (t (put :divide a b))))
                 (t (put name a b)))))
      (loop for (name a b) across (program-instructions program)
            for index from 0
            do (setf (aref images index) (operation name (image a) (and b (image b)))))
      (make-program :instructions (coerce code 'simple-vector) :results (mapcar #'image (program-results program))))))

;;; Statements

(defparameter *longest-part* 50 "What is longer gets a name.")

(defun uses-of-instructions (program)
  "How often each is used for the results; 0 for those that are not needed."
  (let* ((instructions (program-instructions program))
         (uses (make-array (length instructions) :initial-element 0)))
    (flet ((note (operand) (when (integerp operand) (incf (aref uses operand)))))
      (mapc #'note (program-results program))
      (loop for index from (1- (length instructions)) downto 0
            do (when (plusp (aref uses index)) (mapc #'note (rest (aref instructions index)))))
      uses)))

(defun program-statements (program inputs targets language &optional (first 0))
  "Lines that compute PROGRAM from INPUTS, texts, and put its results to TARGETS, texts.  The second value is how many
intermediate results have a name; they are counted from FIRST on."
  (let* ((uses (uses-of-instructions program)) (count first) (lines '())
         (texts (make-array (length uses))))       ; pairs of text and how it binds: 1 a sum, 2 a product, 3 one thing
    (labels ((part (operand)
               (cond ((integerp operand) (aref texts operand))
                     ((eq :input (car operand)) (cons (nth (cdr operand) inputs) 3))
                     ((eq :constant (car operand))
                      (cons (foreign-number (cdr (assoc (cdr operand) *constants*)) language) 3))
                     (t (cons (foreign-number (cdr operand) language) 3))))
             (within (operand least)
               (destructuring-bind (text . binding) (part operand)
                 (if (< binding least) (format nil "(~a)" text) text))))
      (loop for (operation a b) across (program-instructions program)
            for index from 0
            do (when (plusp (aref uses index))
                 (destructuring-bind (text . binding) (foreign-operation operation a b #'within #'part language)
                   (if (and (eql 1 (aref uses index)) (<= (length text) *longest-part*))
                       (setf (aref texts index) (cons text binding))
                       (let ((name (format nil (language-scratch language) (incf count))))
                         (push (format nil (language-declaration language) name text) lines)
                         (setf (aref texts index) (cons name 3)))))))
      (loop for result in (program-results program)
            for target in targets
            do (push (format nil (language-assignment language) target (car (part result))) lines))
      (values (nreverse lines) count))))

(defun foreign-operation (operation a b within part language)
  "The text of an operation and how tightly it binds; WITHIN and PART give the texts of operands."
  (flet ((infix (sign binding left right)
           (cons (format nil "~a ~a ~a" (funcall within a left) sign (funcall within b right)) binding)))
    (case operation
      (:add (infix "+" 1 1 2))
      (:subtract (infix "-" 1 1 2))
      (:multiply (infix "*" 2 2 3))
      (:divide (infix "/" 2 2 3))
      (:negate (cons (format nil "-~a" (funcall within a 3)) 1))
      (:expt (cons (format nil (second (assoc :expt (language-functions language)))
                           (funcall within a 3) (funcall within b 3))
                   3))
      (t (cons (format nil (second (assoc operation (language-functions language)))
                       (car (funcall part a)) (and b (car (funcall part b))))
               3)))))

;;; Names

(defparameter *longest-name* 40)

(defun identifiers (texts language &optional taken)
  "A name that LANGUAGE takes for each of TEXTS, all different, also where capitals do not matter, and none of TAKEN."
  (let ((used (append (mapcar #'string-downcase taken) '())) (names '()))
    (dolist (text texts (nreverse names))
      (let* ((plain (plain-identifier text))
             (name (if (or (member plain (language-words language) :test #'string=)
                           (member (string-downcase plain) used :test #'string=))
                       (loop for k from 1
                             for other = (format nil "~a_~[~;~:;~:*~d~]" plain k)
                             unless (member (string-downcase other) used :test #'string=) return other)
                       plain)))
        (push (string-downcase name) used)
        (push name names)))))

(defun plain-identifier (text)
  "TEXT with underscores for what is no letter of ASCII or digit; it begins with a letter."
  (let* ((marked (map 'string (lambda (char) (if (and (< (char-code char) 128) (alphanumericp char)) char #\_)) text))
         (bare (string-trim "_" marked))
         (name (with-output-to-string (out)
                 (loop for (char next) on (coerce bare 'list)
                       unless (and (eql char #\_) (eql next #\_)) do (write-char char out)))))
    (setq name (subseq name 0 (min *longest-name* (length name))))
    (cond ((string= name "") "x")
          ((digit-char-p (char name 0)) (concatenate 'string "x" name))
          (t name))))

;;; Comments

(defun comment-lines (lines language)
  "LINES as a comment; nothing in them can end it."
  (let ((c (string= (language-comment language) " *")))
    (append (and c '("/*"))
            (loop for line in lines
                  collect (string-right-trim " " (format nil "~a ~a" (language-comment language) (harmless line))))
            (and c '(" */")))))

(defun harmless (line)
  (let ((line (substitute-if #\Space (lambda (char) (< (char-code char) 32)) line)))
    (loop for place = (search "*/" line)
          while place do (setq line (concatenate 'string (subseq line 0 (1+ place)) " " (subseq line (1+ place)))))
    (loop for place = (search "/*" line)
          while place do (setq line (concatenate 'string (subseq line 0 (1+ place)) " " (subseq line (1+ place)))))
    line))
