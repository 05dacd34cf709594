;;; anmech: expressions as text that reads back without running anything.
;;;
;;; Maxima's own reader evaluates on the way ('' does), and what it has read may be called.  So expressions in files
;;; have
;;; a notation of their own, words between spaces, that a few lines read: they make numbers, strings, names and
;;; operators with arguments, and call nothing.  Operators must be on a list, or mean nothing at all, and never come to
;;; mean something: what is read is computed with, and verbs read modules and packages on their way.
;;;
;;;   i12  integer   12p-3  double, mantissa and power of 2   b12p-3/56  bigfloat of so many bits   t..  string   s..
;;; name
;;;   (name ... )  operator with arguments                    [name ... ]  subscripted name
;;;
;;; Characters other than letters, digits and $ _ . - are written by their numbers, %25x is one, and those beyond ASCII
;;; by the octets of UTF-8, which some Lisps take for characters.
;;;
;;; Entry points: DOUBLE-WORD, WORD-DOUBLE, SPLIT-WORDS, WHOLE-NUMBER, ESCAPED, UNESCAPED, STORED-TEXT, STORED-FORM,
;;; UNREADABLE, REJECT; anmech_stored_text, anmech_text_that_reads_back, anmech_stored_form, anmech_stored_program,
;;; anmech_check_cases.

(in-package :anmech)
(needs "session/scope" "session/structures" "session/texts" "session/verbs" "numerics/figures" "sweeps/limits")

;;; Words

(define-condition unreadable (error)
  ((text :initarg :text :reader unreadable-text))
  (:report (lambda (condition stream) (write-string (unreadable-text condition) stream))))

(defun reject (control &rest arguments)
  (error 'unreadable :text (apply #'format nil control arguments)))

(defun split-words (line)
  "What is between spaces."
  (declare (type string line))
  (let ((words '()) (start nil))
    (dotimes (place (length line))
      (if (char= (char line place) #\Space)
          (when start (push (subseq line start place) words) (setq start nil))
          (unless start (setq start place))))
    (when start (push (subseq line start) words))
    (nreverse words)))

(defun plain-character-p (char)
  (let ((code (char-code char)))
    (and (< 32 code 127) (or (alphanumericp char) (find char "$_.-")) t)))

(defun escaped (text)
  (with-output-to-string (out)
    (loop for char across text
          do (if (plain-character-p char) (write-char char out) (format out "~{%~xx~}" (octets-of char))))))

(defparameter *characters-are-octets* (<= char-code-limit 256))

(defun octets-of (char)
  (let ((code (char-code char)))
    (flet ((lower (shift) (logior #x80 (ldb (byte 6 shift) code))))
      (cond ((or *characters-are-octets* (< code #x80)) (list code))
            ((< code #x800) (list (logior #xc0 (ash code -6)) (lower 0)))
            ((< code #x10000) (list (logior #xe0 (ash code -12)) (lower 6) (lower 0)))
            (t (list (logior #xf0 (ash code -18)) (lower 12) (lower 6) (lower 0)))))))

(defun text-of-octets (octets)
  "OCTETS is a text whose characters are octets."
  (with-output-to-string (out)
    (loop with place = 0
          while (< place (length octets))
          do (let* ((code (char-code (char octets place)))
                    (more (cond ((or *characters-are-octets* (< code #x80)) 0)
                                ((<= #xc2 code #xdf) 1) ((<= #xe0 code #xef) 2) ((<= #xf0 code #xf4) 3)
                                (t (reject "a text is not in UTF-8")))))
               (incf place)
               (setq code (if (zerop more) code (ldb (byte (- 6 more) 0) code)))
               (dotimes (k more)
                 (let ((next (if (< place (length octets)) (char-code (char octets place)) 0)))
                   (unless (<= #x80 next #xbf) (reject "a text is not in UTF-8"))
                   (setq code (logior (ash code 6) (logand next #x3f)) place (1+ place))))
               (write-char (or (and (< code char-code-limit) (code-char code)) (reject "a text is not in UTF-8"))
                           out)))))

(defun unescaped (word &optional (start 0))
  (let ((place start) (end (length word)))
    (text-of-octets
     (with-output-to-string (out)
       (loop while (< place end)
             do (let ((char (char word place)))
                  (cond ((char= char #\%)
                         (let* ((stop (position #\x word :start place))
                                (code (whole-number word (1+ place) stop 16)))
                           (unless (<= 0 code 255) (reject "a text is not in UTF-8"))
                           (write-char (code-char code) out)
                           (setq place (1+ stop))))
                        (t (write-char char out) (incf place)))))))))

(defun whole-number (word start end &optional (radix 10))
  (or (and end (> end start) (< (- end start) 100000)
           (handler-case (parse-integer word :start start :end end :radix radix) (error () nil)))
      (reject "~a is no number" (short-word word))))

(defun short-word (word) (if (> (length word) 40) (concatenate 'string (subseq word 0 40) "...") word))

;;; Doubles, to the last bit

(defun double-word (number)
  "NUMBER as mantissa and power of 2."
  (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
    (if (zerop mantissa)
        (if (minusp sign) "-0p0" "0p0")
        (let ((zeros (if (evenp mantissa) (1- (integer-length (logand mantissa (- mantissa)))) 0)))
          (format nil "~:[~;-~]~dp~d" (minusp sign) (ash mantissa (- zeros)) (+ exponent zeros))))))

(defun word-double (word)
  (let* ((p (or (position #\p word) (reject "~a is no number" (short-word word))))
         (mantissa (whole-number word 0 p)) (exponent (whole-number word (1+ p) (length word))))
    (unless (and (<= (integer-length mantissa) 53) (<= -1074 exponent 1023)) (reject "~a is no double" word))
    (cond ((zerop mantissa) (if (char= (char word 0) #\-) (- 0d0) 0d0))
          ((> (+ (integer-length mantissa) exponent) 1024) (reject "~a is no double" word))
          ((> (+ (integer-length mantissa) exponent) -1021) (scale-float (float mantissa 1d0) exponent))
          (t (smallest-double mantissa exponent)))))

(defun smallest-double (mantissa exponent)
  "One that has fewer digits than others: a sum of powers of 2, each of which is exact."
  (let ((number 0d0) (unit least-positive-double-float))
    (dotimes (place (integer-length mantissa) (if (minusp mantissa) (- number) number))
      (when (logbitp place (abs mantissa))
        (incf number (* unit (expt 2d0 (+ 1074 exponent place))))))))

;;; Writing

(defun stored-text (form)
  "FORM as words; an error where it holds what no text can."
  (with-output-to-string (out) (write-stored form out)))

(defun write-stored (form out)
  (flet ((word (control &rest arguments) (apply #'format out control arguments)))
    (cond ((integerp form) (word "i~d" form))
          ((floatp form) (word "~a" (double-word (float form 1d0))))
          ((stringp form) (word "t~a" (escaped form)))
          ((symbolp form) (word "s~a" (escaped (symbol-name form))))
          ((operator-p form 'maxima::bigfloat)
           (word "b~dp~d/~d" (second form) (third form) (third (first form))))
          ((and (consp form) (consp (car form)) (symbolp (caar form)))
           (let ((subscripted (member 'maxima::array (cdar form))))
             (word "~:[(~;[~]~a" subscripted (escaped (symbol-name (caar form))))
             (dolist (argument (rest form)) (write-char #\Space out) (write-stored argument out))
             (word " ~:[)~;]~]" subscripted)))
          (t (complain "~a cannot be written to a file" (one-line form))))))

;;; Reading

(defparameter *typed-operators*
  '((maxima::mdo . "for") (maxima::mdoin . "for") (maxima::mprog . "block") (maxima::mprogn . "( , )")
    (maxima::mcond . "if") (maxima::mreturn . "return") (maxima::mgo . "go") (maxima::msetq . ":") (maxima::mset . "::")
    (maxima::mdefine . ":=") (maxima::mdefmacro . "::=") (maxima::mquote . "'"))
  "How users write what Maxima calls otherwise.")

(defun name-of-operator (symbol)
  (or (cdr (assoc symbol *typed-operators*)) (plain-name symbol)))

(defparameter *harmless-operators*
  '(maxima::mplus maxima::mtimes maxima::mexpt maxima::rat maxima::mabs maxima::mlist maxima::mequal maxima::mnotequal
    maxima::mlessp maxima::mleqp maxima::mgreaterp maxima::mgeqp maxima::mand maxima::mor maxima::mnot maxima::mcond
    maxima::mfactorial maxima::mnctimes maxima::mncexpt maxima::$matrix maxima::$set maxima::$atan2 maxima::$max
    maxima::$min maxima::$unit_step maxima::$signum maxima::$floor maxima::$ceiling maxima::$mod
    maxima::$round maxima::$truncate)
  "Beside nouns, which do nothing.")

(defparameter *mathematics*
  '(maxima::$subst maxima::$substitute maxima::$diff maxima::$integrate maxima::$ratsimp maxima::$fullratsimp
    maxima::$trigsimp
    maxima::$trigreduce maxima::$trigexpand maxima::$radcan maxima::$expand maxima::$factor maxima::$solve
    maxima::$linsolve maxima::$limit maxima::$taylor maxima::$float maxima::$bfloat maxima::$ratcoef maxima::$coeff
    maxima::$determinant maxima::$invert maxima::$transpose maxima::$rank maxima::$first maxima::$second
    maxima::$third maxima::$last maxima::$rest maxima::$length maxima::$lhs maxima::$rhs maxima::$append maxima::$cons
    maxima::$endcons maxima::$makelist maxima::$is maxima::$freeof maxima::$abs maxima::$mod maxima::$floor
    maxima::$num maxima::$denom maxima::$sqrt maxima::$exp maxima::$log maxima::$sin maxima::$cos maxima::$tan
    maxima::$asin maxima::$acos maxima::$atan maxima::$sinh maxima::$cosh maxima::$tanh maxima::$integerp
    maxima::$numberp maxima::$listp maxima::$ident maxima::$genmatrix maxima::$jacobian maxima::$laplace maxima::$@)
  "Functions that compute, and call nothing that they are given the name of.")

(defun meaning-p (symbol)
  "Whether SYMBOL is a function or something else that is called."
  (or (fboundp symbol) (maxima::mget symbol 'maxima::mexpr) (maxima::mget symbol 'maxima::mmacro)
      (some (lambda (property) (get symbol property))
            '(maxima::mfexpr* maxima::mfexpr maxima::mspec maxima::autoload maxima::operators maxima::macro))))

(defun begins-with-p (char symbol)
  (let ((name (symbol-name symbol))) (and (plusp (length name)) (char= (char name 0) char))))

(defun helper-name-p (text)
  "Whether TEXT is a name, as users type it, that helpers of the package have, be their module read or not, or one of a
local variable of theirs."
  (or (eql 0 (search "anmech_" text :test #'char-equal)) (and (find #\` text) t)))

(defun name-of-ours-p (symbol)
  (let ((name (symbol-name symbol)))
    (and (plusp (length name)) (not (member symbol *verbs*)) (helper-name-p (subseq name 1)))))

(defun load-draw ()
  "The one package of Maxima's that verbs load for good and whose functions write files and start programs: names are
judged by what they mean when it is there.  Pictures that cannot be drawn here cannot be drawn by who is judged."
  (handler-case (maxima::$anmech_load_draw) (error () nil)))

(defun may-mean-something-p (symbol)
  "Whether SYMBOL means something, or will when a verb has read modules and packages."
  (or (name-of-ours-p symbol) (meaning-p symbol) (progn (load-draw) (meaning-p symbol))))

(defun always-meaningless-p (symbol)
  "Whether SYMBOL may be a user's unknown function; Lisp's begin otherwise."
  (and (begins-with-p #\$ symbol) (not (may-mean-something-p symbol))))

(defun verb-of-noun (noun)
  (or (get noun 'maxima::verb) (find-symbol (concatenate 'string "$" (subseq (symbol-name noun) 1)) :maxima)))

(defun harmless-noun-p (symbol)
  "Whether SYMBOL is a noun that stays one, or becomes mathematics: some of Maxima's packages evaluate nouns."
  (and (begins-with-p #\% symbol)
       (not (name-of-ours-p symbol))
       (let ((verb (verb-of-noun symbol)))
         (or (null verb) (get symbol 'maxima::operators) (not (meaning-p verb)) (member verb *verbs*)
             (member verb *mathematics*)))))

(defun harmless-operator-p (symbol subscripted)
  "Whether an operator may stand in data: systems, mathematics, and names that mean nothing."
  (or (member symbol *harmless-operators*)
      (member symbol *kinds*)
      (get symbol 'shape)
      (harmless-noun-p symbol)
      (and subscripted (eq symbol 'maxima::lambda))
      (always-meaningless-p symbol)))

(defparameter *deepest* 500 "So deep operators may stand in one another.")

(defun stored-form (text &optional (may-stand-p #'harmless-operator-p))
  "The form that TEXT, made by STORED-TEXT, stands for; a condition UNREADABLE if it is no such text, or holds an
operator of which MAY-STAND-P, a function (symbol subscripted), is false."
  (let ((words (split-words text)))
    (labels ((next () (if words (pop words) (reject "a text ends too early")))
             (form (depth)
               (let ((word (next)))
                 (when (> depth *deepest*) (reject "operators stand too deep in one another"))
                 (case (char word 0)
                   (#\i (whole-number word 1 (length word)))
                   (#\t (coerce (unescaped word 1) 'simple-string))
                   (#\s (name word))
                   (#\b (bigfloat word))
                   (#\( (operation (name word) ")" '() depth))
                   (#\[ (operation (name word) "]" '(maxima::array) depth))
                   (t (word-double word)))))
             (name (word)
               (let ((name (unescaped word 1)))
                 (when (find-if (lambda (char) (< (char-code char) 32)) name) (reject "a name holds the end of a line"))
                 (intern name :maxima)))
             (bigfloat (word)
               (let ((p (position #\p word)) (slash (position #\/ word)))
                 (unless (and p slash (< p slash)) (reject "~a is no number" (short-word word)))
                 (list (list 'maxima::bigfloat 'maxima::simp (whole-number word (1+ slash) (length word)))
                       (whole-number word 1 p) (whole-number word (1+ p) slash))))
             (function-of-an-operation-p (operator)      ; as in f[1](x) or f(x)[1], but no lambda
               (and (eq operator 'maxima::mqapply) words (find (char (first words) 0) "([")
                    (string/= (unescaped (first words) 1) "LAMBDA")))
             (operation (operator end marks depth)
               (unless (or (funcall may-stand-p operator marks) (function-of-an-operation-p operator))
                 (reject "it calls ~a, which may not stand there" (name-of-operator operator)))
               (cons (list* operator 'maxima::simp marks)
                     (loop until (string= (or (first words) (next)) end)
                           collect (form (1+ depth))
                           finally (next)))))
      (let ((form (form 0)))
        (when words (reject "something stands behind its end"))
        form))))

(maxima::defmfun maxima::$anmech_stored_text (form)
  "anmech_stored_text(expr): as text that reads back without running anything."
  (coerce (stored-text form) 'simple-string))

(maxima::defmfun maxima::$anmech_text_that_reads_back (form what)
  "anmech_text_that_reads_back(expr, what): as anmech_stored_text; complains of what cannot be read from a file."
  (let ((text (maxima::$anmech_stored_text form)))
    (handler-case (progn (stored-form text) text)
      (unreadable (condition) (complain "~a cannot be computed elsewhere: ~a" what (unreadable-text condition))))))

(maxima::defmfun maxima::$anmech_stored_form (text what)
  "anmech_stored_form(text, what): the expression; an error where the text, that of WHAT, is none of ours."
  (handler-case (stored-form text)
    (unreadable (condition) (complain "~a is not what a sweep writes: ~a" what (unreadable-text condition)))))

;;; Functions, which sweep_map computes elsewhere: they may call the package's verbs, but for those that write files or
;;; start programs, and what Maxima has of plain mathematics.

(defparameter *program-operators*
  '(maxima::lambda maxima::mprog maxima::mprogn maxima::mdo maxima::mdoin maxima::mreturn maxima::msetq maxima::mqapply
    maxima::mquote maxima::mminus maxima::mquotient)
  "Beside those of mathematics; what a loop counts by is a variable that the program must own, like those of a block.")

(defun writing-verb-p (verb)
  "Whether VERB takes the name of a file or folder, opens something, or calls what it is given."
  (destructuring-bind (required others) (mapcar #'rest (rest (maxima::$anmech_signature verb)))
    (or (intersection '(maxima::$file maxima::$folder maxima::$open) (append required others))
        (some (lambda (part) (search part (symbol-name verb))) '("SWEEP" "CONFIRM")))))

(defun program-operator-p (symbol subscripted)
  (or subscripted
      (member symbol *program-operators*)
      (member symbol *mathematics*)
      (and (member symbol *verbs*) (not (writing-verb-p symbol)))
      (and (member symbol *harmless-operators*) t)
      (harmless-noun-p symbol)
      (always-meaningless-p symbol)))

(defparameter *words* '(maxima::$limit maxima::$degree maxima::$basis maxima::$report maxima::$depends)
  "Names of options that are also those of functions.")

(defun simplifier-p (symbol)
  "Whether SYMBOL is a function that is only simplified, as gamma is, which is also a letter."
  (or (get symbol 'maxima::operators)
      (let ((noun (get symbol 'maxima::noun))) (and noun (get noun 'maxima::operators)))))

(defun function-of-name (atom)
  "The symbol that Maxima calls where it is given ATOM, a name or a string, as a function."
  (cond ((symbolp atom) atom)
        ((stringp atom) (find-symbol (concatenate 'string "$" (maxima::maybe-invert-string-case atom)) :maxima))))

(defun check-names (form)
  "A name of a function that stands as an argument, also as a string, may come to be called by who is given it."
  (if (consp form)
      (mapc #'check-names (rest form))
      (let ((symbol (function-of-name form)))
        (when (and (stringp form) (helper-name-p form) (not (member symbol *verbs*)))
          (reject "it names the function ~a, which may not stand there" form))
        (when (and symbol (may-mean-something-p symbol) (not (member symbol *words*)) (not (simplifier-p symbol))
                   (not (program-operator-p symbol nil)))
          (reject "it names the function ~a, which may not stand there" (plain-name symbol))))))

(defun own-variable-p (symbol)
  "Whether a program may give SYMBOL values: one of Maxima's says where files are sought and what programs are called;
an option that only tells how to compute may stand."
  (and (begins-with-p #\$ symbol)
       (not (name-of-ours-p symbol))
       (or (and (assoc symbol *plain-options*) (not (eq symbol 'maxima::$globalsolve)))
           (not (gethash symbol maxima::*variable-initial-values*)))
       (or (not (boundp symbol)) (assoc symbol *plain-options*) (member symbol maxima::$values))))

(defun check-variables (program)
  (let ((other (or (maxima::$anmech_assigned_elsewhere program)
                   (find-if-not #'own-variable-p (remove nil (bound-variables program))))))   ; nil of a loop without
    (when other (reject "it sets ~a, which is no variable of its own" (one-line other)))))

(maxima::defmfun maxima::$anmech_check_cases (cases complaint)
  "anmech_check_cases(cases, complaint): complains of names in them that a function which is given them might call, and
of what cannot be read from a file."
  (handler-case (progn (check-names cases) (stored-form (stored-text cases)) 'maxima::$done)
    (unreadable (condition) (complain "~a: ~a" complaint (unreadable-text condition)))))

(maxima::defmfun maxima::$anmech_stored_program (text complaint)
  "anmech_stored_program(text, complaint): a lambda expression that calls mathematics alone; of another, the complaint
and why."
  (handler-case (let ((form (stored-form text #'program-operator-p)))
                  (unless (operator-p form 'maxima::lambda) (reject "it is no function of a case"))
                  (check-names form)
                  (check-variables form)
                  form)
    (unreadable (condition) (complain "~a: ~a" complaint (unreadable-text condition)))))
