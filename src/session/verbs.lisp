;;; anmech: how the package sits in a Maxima session.
;;;
;;; Modules are .mac files read at the first call of one of their verbs.  Their definitions become Lisp functions, so
;;; that kill(all) spares them, with every local variable renamed to a symbol of its own function, that no user can have
;;; typed: Maxima scopes dynamically, and otherwise a user's L, n or i would meet ours, and ours each other.  (So a
;;; module writes 'name where it means the symbol itself.)  A definition
;;;
;;;     verb(x, y, [depth = 3, names = []]) := ...
;;;
;;; has options, given as  name = value  after the required arguments; the name is read literally.  Options that several
;;; verbs share are declared once, as a set, by  anmech_option_set(a_set, degree = 2, ...)$;  a verb that takes them
;;; says
;;;
;;;     verb(x, [given : a_set, depth = 3]) := ...
;;;
;;; and has them in its variable `given`, a list name = value.  In  verb(several(x), [depth = 3]) := ...  the last
;;; required argument is a list, which may also be given item by item: verb(a, b).
;;;
;;; A public verb runs under a guard: a fresh context, Maxima's options at their defaults, no interactive question,
;;; every error with the name of the verb that the user called.
;;;
;;; Entry points: anmech_modules, anmech_need, anmech_option_set, NEED-MODULE, DECLARE-OPTION-SET, *VERBS*; for tests
;;; anmech_verbs, anmech_signature.

(in-package :anmech)
(needs "session/guard" "session/prepared_code" "session/rows" "session/scope" "session/texts")

;;; Verbs and modules

(defvar *verbs* '() "Every public verb of the package.")
(defvar *loaded-modules* (make-hash-table :test #'equal) "The names of modules that are read, or being read.")

(defvar *module* nil "The module that is being read.")

(defstruct definition
  "A function of MODULE: REQUIRED is the list of its required parameters, REST a parameter that takes the remaining
arguments or nil, SEVERAL-P whether the last required one is a list that may be given item by item, OPTIONS a list of
(name default), LAMBDA Maxima's lambda expression: its parameters are the required ones, then what PARAMETERS tells: the
name of an option, or the names of all those of a set; PREPARED is the body as a closure, after the first call."
  name module required rest several-p options parameters lambda (prepared :later))

(defun definition-of (symbol) (get symbol 'definition))

(defun install-verb (verb module)
  "Make VERB callable, as a special form and by apply and map; MODULE is read at its first call."
  (pushnew verb *verbs*)
  (setf (get verb 'module) module
        (get verb 'maxima::mfexpr*) 'call-verb-form)
  (install-function verb))

(defun install-function (verb)
  (setf (symbol-function verb) (lambda (&rest arguments) (call-verb verb arguments))))

;;; Maxima's untrace and untimer take the Lisp function away from what has a special form.

(dolist (name '(maxima::$untrace maxima::$untimer))
  (let ((special-form (get name 'maxima::mfexpr*)))
    (setf (get name 'maxima::mfexpr*)
          (lambda (form)
            (prog1 (funcall special-form form)
              (mapc #'install-function (remove-if #'fboundp *verbs*)))))))

(maxima::defmspec maxima::$anmech_modules (form)
  "anmech_modules([\"file\", verb, ...], ...): the public verbs of each module, a file under share/anmech/ or anywhere."
  (dolist (module (rest form) 'maxima::$done)
    (let ((name (maxima::meval (second module))))
      (dolist (verb (cddr module))
        (install-verb (maxima::$verbify verb) name)))))

(defun need-module (name)
  (unless (gethash name *loaded-modules*)
    (setf (gethash name *loaded-modules*) t)
    (let ((done nil))
      (unwind-protect (progn (load-module name) (setq done t))
        (unless done (remhash name *loaded-modules*))))))

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

(defun module-file (name)
  "NAME is that of a module of the package, or absolute: others may add modules of theirs."
  (namestring (merge-pathnames (concatenate 'string name ".mac") *module-directory*)))

(defun load-module (name)
  (with-open-file (stream (module-file name))
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
         (options-p (and rest-p (consp (second tail))))
         (declared (if rest-p (butlast parameters) parameters))
         (several-p (operator-p (first (last declared)) 'maxima::$several))
         (required (if several-p (append (butlast declared) (rest (first (last declared)))) declared))
         (given (and options-p (rest tail)))
         (variables (append required
                            (cond (options-p (mapcar #'second given)) (rest-p (list (second tail))))))
         (renamed (renamings (append variables (bound-variables body)) name)))
    (flet ((rename (form) (rename-locals form renamed)))
      (setf (get name 'definition)
            (make-definition
             :name name
             :module *module*
             :required required
             :rest (and rest-p (not options-p) (second tail))
             :several-p several-p
             :options (loop for option in given
                            append (if (operator-p option 'maxima::mequal)
                                       (list (list (second option) (rename (third option))))
                                       (option-set (third option))))
             :parameters (loop for option in given
                               collect (if (operator-p option 'maxima::mequal)
                                           (second option)
                                           (mapcar #'first (option-set (third option)))))
             :lambda `((maxima::lambda maxima::simp) ((maxima::mlist) ,@(mapcar #'rename variables)) ,(rename body))))))
  (check-option-names name (definition-options (get name 'definition)))
  (unless (get name 'module)
    (setf (symbol-function name) (lambda (&rest arguments) (call-helper name arguments)))))

(defun check-option-names (name options)
  (loop for ((option) . more) on options
        when (assoc option more)
          do (error "~a has the option ~a twice" (plain-name name) (plain-name option))))

(maxima::defmspec maxima::$anmech_option_set (form)
  "anmech_option_set(name, option = default, ...): options that several verbs take."
  (declare-option-set (second form) (mapcar #'rest (cddr form))))

(defun declare-option-set (name options)
  "OPTIONS, a list of (name default), are those of the set NAME."
  (setf (get name 'option-set) options)
  'maxima::$done)

(defun option-set (name)
  "A list of (name default)."
  (let ((options (get name 'option-set 'none)))
    (if (eq options 'none) (error "there is no set of options ~a" (plain-name name)) options)))

;;; Calling

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
        (in-rows (with-guard verb (lambda ()
                                    (with-bare-variables arguments
                                      (lambda () (call-definition definition arguments)))))))))

(defun with-bare-variables (arguments thunk)
  "Call THUNK while the variables in ARGUMENTS have no values: what the user has assigned to them since must not come in
where Maxima evaluates a second time, as solve, sublist and others do.  A function that is given keeps its own."
  (let ((found '()))
    (labels ((walk (form)
               (cond ((operator-p form 'maxima::lambda))
                     ((consp form) (loop while (consp form) do (walk (pop form))))
                     ((and form (symbolp form) (boundp form)) (pushnew form found)))))
      (walk arguments))
    (let* ((bound (intersection found (rest maxima::$values)))
           (values (mapcar #'symbol-value bound))
           (maxima::$values (copy-list maxima::$values)))       ; ev strikes off the list what has no value
      (unwind-protect (progn (mapc #'makunbound bound) (funcall thunk))
        (mapc #'set bound values)))))

(defun call-helper (name arguments)
  (call-definition (definition-of name) arguments))

(defun gathered (arguments place)
  "ARGUMENTS with those from PLACE on, up to the first option, in a list, unless one is there already."
  (let ((end (or (position-if (lambda (argument) (operator-p argument 'maxima::mequal)) arguments :start place)
                 (length arguments))))
    (if (or (= end place) (operator-p (nth place arguments) 'maxima::mlist))
        arguments
        (append (subseq arguments 0 place)
                (list (cons '(maxima::mlist maxima::simp) (subseq arguments place end)))
                (nthcdr end arguments)))))

(defun call-definition (definition arguments)
  (let* ((required (definition-required definition))
         (most (length required)))
    (when (and (definition-several-p definition) (>= (length arguments) most))
      (setq arguments (gathered arguments (1- most))))
    (when (or (< (length arguments) most)
              (and (> (length arguments) most)
                   (not (or (definition-rest definition) (definition-options definition)))))
      (complain "~@[~a ~]expected ~d argument~:p (~a), found ~d"
                (and (not (eq (definition-name definition) *verb*)) (plain-name (definition-name definition)))
                most (english-list required) (length arguments)))
    (if (definition-options definition)
        (call-with-options definition (subseq arguments 0 most) (nthcdr most arguments))
        (apply-lambda definition arguments))))

(defun apply-lambda (definition arguments)
  "A rest parameter takes its arguments as a Maxima list."
  (let ((most (length (definition-required definition))))
    (apply-to-all definition
                  (if (definition-rest definition)
                      (append (subseq arguments 0 most) (list (cons '(maxima::mlist) (nthcdr most arguments))))
                      arguments))))

(defun apply-to-all (definition arguments)
  "ARGUMENTS are for all parameters.  Under debugmode(true) Maxima evaluates, for its debugger."
  (let ((body (and (not maxima::*mdebug*) (definition-body definition))))
    (if body
        (call-with-values (rest (second (definition-lambda definition))) arguments body)
        (maxima::mlambda (definition-lambda definition) arguments (definition-name definition) t nil))))

(defun definition-body (definition)
  "A closure; or nil, where functions of its own ask for Maxima's frame of a call."
  (when (eq (definition-prepared definition) :later)
    (let ((body (third (definition-lambda definition))))
      (setf (definition-prepared definition) (and (not (calls-p body 'maxima::$local)) (prepared body)))))
  (definition-prepared definition))

(defun call-with-options (definition arguments given)
  (let* ((chosen (chosen-options definition given))
         (values (append chosen (defaults definition arguments chosen))))
    (labels ((value (name) (cdr (assoc name values)))
             (group (names)
               (cons '(maxima::mlist maxima::simp)
                     (loop for name in names collect `((maxima::mequal maxima::simp) ,name ,(value name))))))
      (apply-to-all definition
                    (append arguments
                            (loop for parameter in (definition-parameters definition)
                                  collect (if (listp parameter) (group parameter) (value parameter))))))))

(defun defaults (definition arguments chosen)
  "An alist of the values of the options that are not among those CHOSEN; they are evaluated with the required
parameters bound, so that they may speak of them."
  (let ((found '()))
    (call-with-values (subseq (rest (second (definition-lambda definition))) 0 (length arguments))
                      arguments
                      (lambda ()
                        (loop for (option nil default) in (prepared-options definition)
                              unless (assoc option chosen)
                                do (push (cons option (evaluate default)) found))))
    (nreverse found)))

(defun prepared-options (definition)
  "Lists of name, default, and a closure that returns its value."
  (let ((options (definition-options definition)))
    (unless (third (first options))
      (setf (definition-options definition)
            (setq options (loop for (name default) in options collect (list name default (prepared default))))))
    options))

(defun chosen-options (definition given)
  "GIVEN is a list of equations name = value; an alist, or an error."
  (let ((known (mapcar #'first (definition-options definition))) (chosen '()))
    (dolist (equation given (nreverse chosen))
      (unless (and (operator-p equation 'maxima::mequal) (symbolp (second equation)))
        (complain "expected an option name = value, found ~a; the options are ~a"
                  (one-line equation) (english-list known)))
      (unless (member (second equation) known)
        (complain "no option ~a; ~@[is ~a meant? ~]the options are ~a" (plain-name (second equation))
                  (likely-name (second equation) known) (english-list known)))
      (when (assoc (second equation) chosen)
        (complain "option ~a is given twice" (plain-name (second equation))))
      (push (cons (second equation) (third equation)) chosen))))

;;; Calling from within a module, prepared

(pushnew 'prepared-call-of-module *kinds-of-calls*)

(defun prepared-call-of-module (form)
  (let* ((head (caar form)) (definition (definition-of head)))
    (cond ((get head 'module) (left-to-maxima (cons (first form) (mapcar #'option-prepared (rest form)))))
          (definition (prepared-call-of-helper definition (mapcar #'prepared (rest form)))))))

(defun option-prepared (argument)
  "An ARGUMENT of a verb, which may be an option, name = value."
  (if (and (operator-p argument 'maxima::mequal) (symbolp (second argument)))
      (list (first argument) (second argument) (handed-on (third argument)))
      (handed-on argument)))

(defun prepared-call-of-helper (definition arguments)
  (if (takes-just-p definition (length arguments))
      (lambda () (simplified (apply-to-all definition (evaluate-all arguments))))
      (lambda () (simplified (call-definition definition (evaluate-all arguments))))))

(defun takes-just-p (definition count)
  "Whether COUNT arguments are one for each parameter."
  (and (= count (length (definition-required definition)))
       (not (definition-several-p definition))
       (not (definition-rest definition))
       (not (definition-options definition))))

;;; For tests

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
