;;; anmech: how the package sits in a Maxima session.
;;;
;;; Modules are .mac files read at the first call of one of their verbs.  Their definitions become Lisp functions, so
;;; that kill(all) spares them, with every local variable renamed to a symbol of its own function, that no user can have
;;; typed: Maxima scopes dynamically, and otherwise a user's L, n or i would meet ours, and ours each other.  (So a
;;; module writes 'name where it means the symbol itself.)  A definition
;;;
;;;     verb(x, y, [depth = 3, names = []]) := ...
;;;
;;; has options, given as  name = value  after the required arguments; the name is read literally.  A public verb runs
;;; under a guard: a fresh context, Maxima's options at their defaults, no interactive question, every error with the
;;; name of the verb that the user called.
;;;
;;; Entry points for the front door: anmech_modules.  For modules: anmech_error, anmech_structure, anmech_remember,
;;; anmech_need.  For tests: anmech_verbs, anmech_signature.

(in-package :anmech)

(defmacro with-maxima-errors (&body body)
  "Maxima's errors inside BODY are Lisp conditions of type maxima::maxima-$error, and print nothing."
  `(let ((maxima::*merror-signals-$error-p* t)) ,@body))

;;; Verbs and modules

(defvar *verbs* '() "Every public verb of the package.")
(defvar *verb* nil "The verb that the user called; nil outside of all verbs.")
(defvar *loaded-modules* '())

(defvar *module* nil "The module that is being read.")

(defstruct definition
  "A function of MODULE: REQUIRED is the list of its required parameters, REST a parameter that takes the remaining
arguments or nil, OPTIONS a list of (name parameter default), LAMBDA Maxima's lambda expression over all of them."
  name module required rest options lambda)

(defun definition-of (symbol) (get symbol 'definition))

(defun plain-name (symbol)
  "SYMBOL as Maxima prints it."
  (coerce (maxima::mstring symbol) 'string))

(defun one-line (expression &optional (most 200))
  "EXPRESSION in Maxima's one-line notation, cut after MOST characters."
  (let ((text (coerce (maxima::mstring expression) 'string)))
    (if (> (length text) most) (concatenate 'string (subseq text 0 most) " ...") text)))

(defvar *outer-form* #'identity "What turns the package's own form of an expression into the user's.")

(defun maxima-text (expression &optional (limit 120))
  "EXPRESSION as the user would type it, shortened to LIMIT characters."
  (let ((text (maxima::mfuncall 'maxima::$string (funcall *outer-form* expression))))
    (if (> (length text) limit) (concatenate 'string (subseq text 0 limit) "...") text)))

(defun complain (control &rest arguments)
  "Signal the error  verb: sentence."
  (maxima::merror "~A" (format nil "~@[~a: ~]~?" (and *verb* (plain-name *verb*)) control arguments)))

(defun install-verb (verb module)
  "Make VERB callable, as a special form and by apply and map; MODULE is read at its first call."
  (pushnew verb *verbs*)
  (setf (get verb 'module) module
        (get verb 'maxima::mfexpr*) 'call-verb-form
        (symbol-function verb) (lambda (&rest arguments) (call-verb verb arguments))))

(maxima::defmspec maxima::$anmech_modules (form)
  "anmech_modules([\"file\", verb, ...], ...): the public verbs of each module."
  (dolist (module (rest form) 'maxima::$done)
    (let ((name (second module)))
      (dolist (verb (cddr module))
        (install-verb (maxima::$verbify verb) name)))))

(defun need-module (name)
  (unless (member name *loaded-modules* :test #'string=)
    (push name *loaded-modules*)
    (let ((done nil))
      (unwind-protect (progn (load-module name) (setq done t))
        (unless done (setq *loaded-modules* (remove name *loaded-modules* :test #'string=)))))))

(maxima::defmfun maxima::$anmech_need (&rest names)
  "anmech_need(name, ...): other modules (\"systems\") or kernel files (\"jets.lisp\") that a module stands on."
  (dolist (name names 'maxima::$done)
    (let ((end (search ".lisp" name)))
      (if end (load-kernel (subseq name 0 end)) (need-module name)))))

(defun verb-definition (verb)
  (need-module (get verb 'module))
  (or (definition-of verb)
      (error "the module ~a does not define ~a" (get verb 'module) (plain-name verb))))

;;; Reading a module

(defun load-module (name)
  (with-open-file (stream (concatenate 'string *module-directory* name ".mac"))
    (let ((*module* name) (*package* (find-package :maxima)) (*read-base* 10) (maxima::*mread-prompt* "")
          (end (list nil)))
      (declare (special maxima::*mread-prompt*))
      (maxima::newline stream)
      (loop for form = (let (maxima::*prompt-on-read-hang*)
                         (declare (special maxima::*prompt-on-read-hang*))
                         (maxima::mread stream end))
            until (eq form end)
            do (load-statement (third form))))))

(defun load-statement (statement)
  (if (operator-p statement 'maxima::mdefine)
      (destructuring-bind (head body) (rest statement)
        (define-function (caar head) (rest head) body))
      (maxima::meval statement)))

(defun operator-p (form operator)
  (and (consp form) (consp (car form)) (eq (caar form) operator)))

(defun check-new (name)
  "Modules share one space of names: no definition may take the place of another's."
  (let ((before (definition-of name)))
    (when (if before
              (not (equal (definition-module before) *module*))
              (and (fboundp name) (not (equal (get name 'module) *module*))))
      (error "~a of the module ~a is defined already~@[, in ~a~]"
             (plain-name name) *module* (and before (definition-module before))))))

(defun define-function (name parameters body)
  "NAME(PARAMETERS) := BODY, as a Lisp function that kill(all) does not know."
  (check-new name)
  (setq body (with-decided-predicates body))
  (let* ((tail (first (last parameters)))
         (rest-p (operator-p tail 'maxima::mlist))
         (options-p (and rest-p (operator-p (second tail) 'maxima::mequal)))
         (required (if rest-p (butlast parameters) parameters))
         (options (and options-p (rest tail)))
         (variables (append required
                            (cond (options-p (mapcar #'second options)) (rest-p (list (second tail))))))
         (renamed (renamings (append variables (bound-variables body)) name)))
    (flet ((rename (form) (rename-locals form renamed)))
      (setf (get name 'definition)
            (make-definition
             :name name
             :module *module*
             :required required
             :rest (and rest-p (not options-p) (second tail))
             :options (loop for (nil option default) in options
                            collect (list option (rename option) (rename default)))
             :lambda `((maxima::lambda maxima::simp) ((maxima::mlist) ,@(mapcar #'rename variables)) ,(rename body))))))
  (unless (get name 'module)
    (setf (symbol-function name) (lambda (&rest arguments) (call-helper name arguments)))))

;;; Maxima's options

(defparameter *plain-options*
  '((maxima::$inflag nil) (maxima::$partswitch nil) (maxima::$float nil) (maxima::$numer nil) (maxima::$keepfloat nil)
    (maxima::$ratprint nil) (maxima::$ratfac nil) (maxima::$algebraic nil) (maxima::$listarith t)
    (maxima::$prederror nil) (maxima::$expop 0) (maxima::$expon 0) (maxima::$exponentialize nil)
    (maxima::$demoivre nil) (maxima::$halfangles nil) (maxima::$trigexpand nil) (maxima::$logarc nil)
    (maxima::$logexpand t) (maxima::$radexpand t) (maxima::$exptsubst nil) (maxima::$derivsubst nil)
    (maxima::$opsubst t) (maxima::$sumexpand nil) (maxima::$simpsum nil) (maxima::$factorflag nil)
    (maxima::$globalsolve nil) (maxima::$programmode t) (maxima::$backsubst t) (maxima::$linsolve_params t)
    (maxima::$linsolvewarn nil) (maxima::$solveradcan nil) (maxima::$solveexplicit nil) (maxima::$solvetrigwarn nil)
    (maxima::$negdistrib t) (maxima::$distribute_over t) (maxima::$domain maxima::$real)
    (maxima::$m1pbranch nil) (maxima::$letrat nil) (maxima::$stardisp nil) (maxima::$refcheck nil)
    (maxima::$ratsimpexpons nil) (maxima::$ratdenomdivide t) (maxima::$ratexpand nil) (maxima::$piece nil)
    (maxima::$doallmxops t) (maxima::$domxmxops t) (maxima::$domxplus nil) (maxima::$doscmxops nil)
    (maxima::$doscmxplus nil) (maxima::$sparse nil) (maxima::$ratmx nil) (maxima::$detout nil)
    (maxima::$mx0simp t) (maxima::$matrix_element_transpose nil) (maxima::$matrix_element_mult "*")
    (maxima::$matrix_element_add "+") (maxima::$scalarmatrixp t) (maxima::$assumescalar t) (maxima::$simp t)
    (maxima::$errexp1 nil) (maxima::$errexp2 nil) (maxima::$exptdispflag t) (maxima::$logabs nil)
    (maxima::$ratwtlvl nil) (maxima::$realonly nil) (maxima::$trigexpandtimes t) (maxima::$gcd maxima::$spmod)
    (maxima::$maxmin_effort 10)
    (maxima::$listconstvars nil) (maxima::$infeval nil)
    (maxima::$ratvars ((maxima::mlist maxima::simp))) (maxima::varlist nil) (maxima::genvar nil))
  "Maxima's options at their defaults: what the user has set must not change what we compute.")

;;; Local variables get names of their own

(defun binder-variables (form)
  "The variables that FORM itself binds."
  (flet ((names (list)
           (loop for item in list
                 append (cond ((symbolp item) (list item))
                              ((operator-p item 'maxima::msetq) (list (second item)))
                              ((operator-p item 'maxima::mlist) (rest item))
                              ((operator-p item 'maxima::mquote) (rest item))))))
    (case (caar form)
      ((maxima::mprog maxima::lambda)
       (and (operator-p (second form) 'maxima::mlist) (names (rest (second form)))))
      ((maxima::mdo maxima::mdoin) (names (list (second form))))
      ((maxima::$makelist maxima::$sum maxima::$product maxima::%sum maxima::%product)
       (and (symbolp (third form)) (names (list (third form)))))
      (maxima::$create_list (names (remove-if-not #'symbolp (cddr form)))))))

(defun bound-variables (form)
  "Every variable that FORM or a part of it binds."
  (and (consp form)
       (append (and (consp (car form)) (binder-variables form))
               (loop for part in form append (bound-variables part)))))

(defun renamings (variables function)
  "Private names of the VARIABLES of FUNCTION, which no other function shares: so a lambda handed to a helper sees the
variables of the function that it stands in.  An option of Maxima's is bound under its own name, for it is Maxima that
reads it."
  (loop for variable in (remove-duplicates (remove nil variables))
        unless (assoc variable *plain-options*)
        collect (cons variable (intern (concatenate 'string (symbol-name variable) "`" (symbol-name function))
                                                :maxima))))

(defun rename-locals (form renamed)
  "FORM with its local variables renamed, except where a symbol stands for itself: quoted ('name), as the name of a
field (sys@name) or of an option (verb(sys, name = ..))."
  (labels ((walk (form)
             (cond ((symbolp form) (let ((pair (assoc form renamed))) (if pair (cdr pair) form)))
                   ((atom form) form)
                   ((and (operator-p form 'maxima::mquote) (symbolp (second form))) form)
                   ((operator-p form 'maxima::$@) (list (first form) (walk (second form)) (third form)))
                   ((and (consp (car form)) (get (caar form) 'module))
                    (cons (first form) (mapcar #'walk-argument (rest form))))
                   ((consp (car form)) (cons (cons (walk (caar form)) (cdar form)) (mapcar #'walk (rest form))))
                   (t (mapcar #'walk form))))
           (walk-argument (argument)
             (if (operator-p argument 'maxima::mequal)
                 (list (first argument) (second argument) (walk (third argument)))
                 (walk argument))))
    (walk form)))

;;; Predicates.  Maxima's sublist, every ... evaluate what a predicate has returned: an equation between the user's
;;; variables would be asked of their values.  So  lambda([e], lhs(e) = x)  in such a place decides there.

(defun with-decided-predicates (form)
  (labels ((walk (form)
             (cond ((atom form) form)
                   ((and (consp (car form))
                         (member (caar form) '(maxima::$sublist maxima::$sublist_indices maxima::$every maxima::$some
                                               maxima::$subset)))
                    (cons (car form) (mapcar (lambda (part) (decided (walk part))) (rest form))))
                   (t (cons (walk (car form)) (walk (cdr form))))))
           (decided (form)
             (if (and (operator-p form 'maxima::lambda) (predicate-form-p (first (last form))))
                 (append (butlast form) `(((maxima::$is) ,(first (last form)))))
                 form)))
    (walk form)))

(defun predicate-form-p (form)
  (and (consp form) (consp (car form))
       (member (caar form) '(maxima::mequal maxima::mnotequal maxima::mgreaterp maxima::mlessp maxima::mgeqp
                             maxima::mleqp maxima::mand maxima::mor maxima::mnot))))

;;; Calling

(defun english-list (names)
  (format nil "~{~a~^, ~}" (mapcar #'plain-name names)))

(defun call-verb-form (form)
  "The special form of every verb: arguments are evaluated, names of options are not."
  (let* ((verb (caar form))
         (required (length (definition-required (verb-definition verb))))
         (arguments (loop for argument in (rest form)
                          for place from 0
                          collect (if (and (>= place required) (operator-p argument 'maxima::mequal)
                                           (symbolp (second argument)))
                                      (list (first argument) (second argument) (maxima::meval (third argument)))
                                      (maxima::meval argument)))))
    (call-verb verb arguments)))

(defun call-verb (verb arguments)
  (let ((definition (verb-definition verb)))
    (if *verb*
        (call-definition definition arguments)
        (with-guard verb (lambda ()
                           (with-bare-variables arguments (lambda () (call-definition definition arguments))))))))

(defun with-bare-variables (arguments thunk)
  "Call THUNK while the variables in ARGUMENTS have no values: what the user has assigned to them since must not come in
where Maxima evaluates a second time, as solve, sublist and others do."
  (let ((found '()))
    (labels ((walk (form)
               (cond ((consp form) (walk (car form)) (walk (cdr form)))
                     ((and form (symbolp form) (boundp form)) (pushnew form found)))))
      (walk arguments))
    (let* ((bound (intersection found (rest maxima::$values)))
           (values (mapcar #'symbol-value bound))
           (maxima::$values (copy-list maxima::$values)))       ; ev strikes off the list what has no value
      (unwind-protect (progn (mapc #'makunbound bound) (funcall thunk))
        (mapc #'set bound values)))))

(defun call-helper (name arguments)
  (call-definition (definition-of name) arguments))

(defun call-definition (definition arguments)
  (let* ((required (definition-required definition))
         (most (length required)))
    (when (or (< (length arguments) most)
              (and (> (length arguments) most)
                   (not (or (definition-rest definition) (definition-options definition)))))
      (complain "~@[~a ~]expected ~d argument~:p (~a), found ~d"
                (and (not (eq (definition-name definition) *verb*)) (plain-name (definition-name definition)))
                most (english-list required) (length arguments)))
    (let ((given (nthcdr most arguments)) (lambda (definition-lambda definition)))
      (if (definition-options definition)
          (call-with-options lambda (subseq arguments 0 most) definition given)
          (apply-lambda lambda arguments definition)))))

(defun apply-lambda (lambda arguments definition)
  "A rest parameter takes its arguments as a Maxima list."
  (let ((most (length (definition-required definition))))
    (maxima::mlambda lambda
                     (if (definition-rest definition)
                         (append (subseq arguments 0 most) (list (cons '(maxima::mlist) (nthcdr most arguments))))
                         arguments)
                     (definition-name definition) t nil)))

(defun call-with-options (lambda arguments definition given)
  "Defaults are evaluated with the required parameters bound, so that they may speak of them."
  (let* ((options (definition-options definition))
         (chosen (chosen-options definition given))
         (parameters (rest (second lambda)))
         (defaults `((maxima::lambda maxima::simp)
                     ((maxima::mlist) ,@(subseq parameters 0 (length arguments)))
                     ((maxima::mlist) ,@(loop for (name nil default) in options
                                              collect (if (assoc name chosen) nil default)))))
         (values (rest (maxima::mlambda defaults arguments (definition-name definition) t nil))))
    (maxima::mlambda lambda
                     (append arguments
                             (loop for (name) in options
                                   for default in values
                                   collect (let ((pair (assoc name chosen))) (if pair (cdr pair) default))))
                     (definition-name definition) t nil)))

(defun chosen-options (definition given)
  "GIVEN is a list of equations name = value; an alist, or an error."
  (let ((known (mapcar #'first (definition-options definition))) (chosen '()))
    (dolist (equation given (nreverse chosen))
      (unless (and (operator-p equation 'maxima::mequal) (symbolp (second equation)))
        (complain "expected an option name = value, found ~a; the options are ~a"
                  (one-line equation) (english-list known)))
      (unless (member (second equation) known)
        (complain "no option ~a; the options are ~a" (plain-name (second equation)) (english-list known)))
      (when (assoc (second equation) chosen)
        (complain "option ~a is given twice" (plain-name (second equation))))
      (push (cons (second equation) (third equation)) chosen))))

;;; The guard

(defparameter *kept-variables*
  '(maxima::$multiplicities maxima::$%rnum maxima::$%rnum_list maxima::$gensumnum
    maxima::$integration_constant_counter)
  "Variables that Maxima's own functions change on the way; they are as before at the end.")

(defvar *fact-readers* '() "Functions that are told what the user has assumed, when a verb begins.")

(defun no-question (message flag &rest more)
  (declare (ignore flag more))
  (let ((text (string-trim '(#\Space #\Newline)
                           (format nil "~{~a~}"
                                   (mapcar (lambda (part)
                                             (if (stringp part) part (one-line (funcall *outer-form* part))))
                                           (if (consp message) (rest message) (list message)))))))
    (complain "\"~a\" cannot be decided; say so with assume(...) first" text)))

(defun with-guard (verb thunk)
  "Call THUNK as the body of VERB; every error comes out as one sentence that begins with the name of VERB."
  (let ((problem nil) (last-error maxima::$error))
    (let ((value (block attempt
                   (if maxima::*mdebug*
                       (call-guarded verb thunk)
                       (handler-case (with-maxima-errors (maxima::rat-error-to-merror (call-guarded verb thunk)))
                         (maxima::maxima-$error () (setq problem (error-sentence verb)))
                         #+sbcl (sb-sys:interactive-interrupt (interrupt) (error interrupt))
                         (storage-condition ()
                           (setq problem (format nil "~a: internal error: a recursion of Maxima does not end"
                                                 (plain-name verb))))
                         (error (condition)
                           (setq problem (format nil "~a: internal error: ~a" (plain-name verb) condition))))))))
      (when problem (maxima::merror "~A" problem))
      (setq maxima::$error last-error)          ; errors inside that the verb knew what to do with
      value)))

(defun error-sentence (verb)
  "Maxima's last error, as text that begins with the name of VERB."
  (let* ((maxima::$display2d nil)
         (text (string-trim '(#\Space #\Newline)
                            (apply #'maxima::aformat nil (second maxima::$error) (cddr maxima::$error))))
         (name (plain-name verb)))
    (if (eql 0 (search name text)) text (format nil "~a: ~a" name text))))

(defun active-facts ()
  "What the user has assumed: in the present context, in those that it rests on, and in those activated."
  (maxima::contextmark)
  (loop for context in (rest maxima::$contexts)
        when (plusp (or (get context 'maxima::cmark) 0))
          append (rest (maxima::$facts context))))

(defun call-guarded (verb thunk)
  (let* ((*verb* verb)
         (maxima::$myoptions (copy-list maxima::$myoptions))          ; what a block binds is listed there, too
         (reader (symbol-function 'maxima::retrieve))
         (variables (remove-if-not #'boundp (append *kept-variables* (mapcar #'first *plain-options*))))
         (before (mapcar #'symbol-value variables))
         (outer maxima::$context)
         (facts (active-facts))
         (scratch (maxima::$supcontext)))
    (unwind-protect
         (progn (loop for (option value) in *plain-options* do (set option value))
                (forget-under-other facts)
                (when facts (dolist (reader *fact-readers*) (funcall reader facts)))
                (setf (symbol-function 'maxima::retrieve) #'no-question)
                (funcall thunk))
      (setf (symbol-function 'maxima::retrieve) reader)
      (mapc #'set variables before)
      (maxima::meval `((maxima::msetq) maxima::$context ((maxima::mquote) ,outer)))
      (maxima::$killcontext scratch))))

;;; For modules

(maxima::defmfun maxima::$anmech_error (&rest parts)
  "anmech_error(part, ...): the error  verb: parts joined; expressions are shown on one line."
  (complain "~{~a~}" (mapcar (lambda (part) (if (stringp part) part (one-line part))) parts)))

(defun call-with-output-file (file writer)
  "Call WRITER with a stream to FILE, a new one; a sentence where there can be none."
  (handler-case (with-open-file (stream file :direction :output :if-exists :supersede)
                  (funcall writer stream))
    ((or file-error stream-error) () (complain "cannot write the file ~a" file))))

(maxima::defmfun maxima::$anmech_write_text (file text)
  "anmech_write_text(file, text): FILE holds TEXT."
  (call-with-output-file file (lambda (stream) (write-string text stream)))
  'maxima::$done)

(maxima::defmfun maxima::$anmech_verb ()
  "anmech_verb(): the verb that the user called, as a string."
  (if *verb* (plain-name *verb*) "anmech"))

(maxima::defmfun maxima::$anmech_verbs ()
  "anmech_verbs(): every public verb."
  (cons '(maxima::mlist maxima::simp)
        (sort (copy-list *verbs*) #'string< :key #'symbol-name)))

(maxima::defmfun maxima::$anmech_signature (verb)
  "anmech_signature(verb): [required parameters, names of options, or of an argument that may be left out]."
  (let ((definition (verb-definition verb)))
    `((maxima::mlist maxima::simp)
      ((maxima::mlist maxima::simp) ,@(definition-required definition))
      ((maxima::mlist maxima::simp) ,@(if (definition-rest definition)
                                          (list (definition-rest definition))
                                          (mapcar #'first (definition-options definition)))))))

;;; What has been derived from an object, remembered outside of it

(defvar *remembered* '() "List of (object . ((key . value) ...)), the latest first; objects are compared by identity.")
(defvar *facts* '() "The assumptions under which all this was derived.")
(defconstant +most-remembered+ 40)

(defun forget-under-other (facts)
  "What was derived under other assumptions than FACTS may be wrong now."
  (unless (equal facts *facts*)
    (setq *remembered* '() *facts* facts)))

(maxima::defmspec maxima::$anmech_remember (form)
  "anmech_remember(object, key, expr): the value of expr, evaluated once for this very object and key."
  (destructuring-bind (object-form key-form value-form) (rest form)
    (let* ((object (maxima::meval object-form))
           (key (maxima::meval key-form))
           (entry (or (assoc object *remembered* :test #'eq)
                      (first (push (list object) *remembered*))))
           (pair (assoc key (rest entry) :test #'equal)))
      (when (> (length *remembered*) +most-remembered+)
        (setq *remembered* (subseq *remembered* 0 +most-remembered+)))
      (if pair
          (cdr pair)
          (let ((value (maxima::meval value-form)))
            (push (cons key value) (rest entry))
            value)))))

;;; Structures: expressions that are their own constructor call, with fields

(defstruct shape
  "FIELDS are the names of the positional arguments, OPTIONS a list of (name . helper that gives an absent one's
value)."
  fields options)

(maxima::defmspec maxima::$anmech_structure (form)
  "anmech_structure(head(field, ..., [option = helper, ...])): objects of that form have these fields.
An option that an object does not carry has the value helper(object)."
  (let* ((template (second form))
         (head (caar template))
         (tail (first (last template)))
         (options-p (operator-p tail 'maxima::mlist)))
    (setf (get head 'shape)
          (make-shape :fields (if options-p (butlast (rest template)) (rest template))
                          :options (and options-p (mapcar (lambda (option) (cons (second option) (third option)))
                                                          (rest tail))))
          (get head 'maxima::dimension) 'display-structure
          (get head 'maxima::tex) 'tex-structure
          (get head 'maxima::wxxml) 'wxxml-structure)
    'maxima::$done))

(defun shape-of (object)
  (and (consp object) (consp (car object)) (symbolp (caar object)) (get (caar object) 'shape)))

(maxima::defmfun maxima::$anmech_make (head &rest arguments)
  "anmech_make(head, arg, ...): the inert object head(arg, ...)."
  (cons (list head 'maxima::simp) arguments))

(maxima::defmfun maxima::$anmech_is (object &rest heads)
  "anmech_is(object, head, ...): whether it is a structure with one of these heads."
  (and (shape-of object) (member (caar object) heads) t))

(maxima::defmfun maxima::$anmech_head (object)
  "anmech_head(object): its head, or false if it is no structure of this package."
  (and (shape-of object) (caar object)))

(defun field-value (object field)
  (let* ((shape (shape-of object))
         (place (position field (shape-fields shape)))
         (option (assoc field (shape-options shape)))
         (carried (and option (find-if (lambda (argument)
                                         (and (operator-p argument 'maxima::mequal) (eq (second argument) field)))
                                       (nthcdr (length (shape-fields shape)) (rest object))))))
    (cond (place (nth place (rest object)))
          (carried (third carried))
          (option (maxima::mapply1 (cdr option) (list object) (cdr option) nil))
          (t (let ((*verb* (or *verb* (caar object))))
               (complain "no field ~a; the fields are ~a" (one-line field)
                         (english-list (append (shape-fields shape)
                                               (mapcar #'car (shape-options shape))))))))))

(let ((fields-of-others #'maxima::$@-function))
  (setf (symbol-function 'maxima::$@-function)
        (lambda (object field)
          (if (shape-of object) (field-value object field) (funcall fields-of-others object field)))))

(defun shortened (object &optional (most 60))
  "OBJECT as an ordinary call for display, long arguments replaced by dots."
  (labels ((weight (form) (if (atom form) 1 (loop for part in (rest form) sum (weight part))))
           (short (form)
             (cond ((<= (weight form) most) form)
                   ((and (operator-p form 'maxima::mequal) (symbolp (second form)))
                    (list (first form) (second form) (short (third form))))
                   (t 'maxima::|$...|))))
    (cons (list (caar object)) (mapcar #'short (rest object)))))

(defun display-structure (form result)
  (maxima::dimension-function (shortened form) result))

(defun tex-structure (form left right)
  (maxima::tex-function (shortened form) left right nil))

(defun wxxml-structure (form left right)
  (funcall 'maxima::wxxml-function (shortened form) left right))
