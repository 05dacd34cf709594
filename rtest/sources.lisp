;;;; sources.lisp: the files of the package, read but not run: what each defines, uses, declares to need, and says of
;;;; itself.  For names.lisp and house.lisp.
;;;;
;;;; A source is a module (share/anmech/.., .mac) or a file of the kernel (src/.., .lisp).  Modules and kernel files are
;;;; read as late as possible, so a function that the kernel gives to modules shares their space of names.

(in-package :anmech-tests)

(defstruct source
  "NAME as anmech_need takes it, systems/view or algebra/jets.lisp; HEADER: its first comment; NEEDS: names; DEFINED,
STRUCTURES (heads) and USED: symbols."
  file name header needs defined structures used)

(defun files-of (pattern)
  (sort (mapcar #'namestring (directory (concatenate 'string *root* pattern))) #'string<))

(defun module-files () (files-of "share/anmech/**/*.mac"))
(defun kernel-files () (files-of "src/**/*.lisp"))

(defun kernel-file-p (file) (and (search ".lisp" file) t))

(defun name-of-file (file)
  (let* ((directory (concatenate 'string *root* (if (kernel-file-p file) "src/" "share/anmech/")))
         (name (subseq file (length directory))))
    (if (kernel-file-p file) name (subseq name 0 (search ".mac" name)))))

(defvar *sources* '())

(defun sources ()
  "All of them, read once; not the front door, which has no definitions."
  (or *sources*
      (setq *sources*
            (append (mapcar #'module-source (remove "anmech" (module-files) :key #'name-of-file :test #'string=))
                    (mapcar #'kernel-source (kernel-files))))))

(defun header-of (file)
  "The comment with which FILE begins."
  (with-open-file (stream file)
    (let ((lines (loop for line = (read-line stream nil)
                       while (and line (or (not (kernel-file-p file)) (eql 0 (search ";" line))))
                       collect line
                       until (and (not (kernel-file-p file)) (search "*/" line)))))
      (format nil "~{~a~%~}" lines))))

;;; Modules

(defun statements-of (file)
  (with-open-file (stream file)
    (loop for statement = (next-expression stream)
          while statement
          collect (third statement))))

(defun module-source (file)
  (let ((statements (statements-of file)))
    (make-source :file file
                 :name (name-of-file file)
                 :header (header-of file)
                 :needs (remove-duplicates (needs-in statements) :test #'string=)
                 :defined (remove nil (mapcar #'defined-name statements))
                 :structures (remove nil (mapcar #'structure-head statements))
                 :used (remove-duplicates (uses-in (mapcar #'definition-body statements))))))

(defun defined-name (statement)
  (and (anmech::operator-p statement 'maxima::mdefine) (caar (second statement))))

(defun structure-head (statement)
  "The head of a structure, or the name of a set of options, that STATEMENT declares."
  (cond ((anmech::operator-p statement 'maxima::$anmech_structure) (caar (second statement)))
        ((anmech::operator-p statement 'maxima::$anmech_option_set) (second statement))))

(defun definition-body (statement)
  "Without the head of a definition, whose names are its own."
  (cond ((anmech::operator-p statement 'maxima::mdefine)
         (list (third statement) (defaults-of (rest (second statement)))))
        ((anmech::operator-p statement 'maxima::$anmech_structure) (rest (second statement)))
        (t statement)))

(defun defaults-of (parameters)
  (let ((tail (first (last parameters))))
    (and (anmech::operator-p tail 'maxima::mlist)
         (mapcar #'third (remove-if-not (lambda (e) (anmech::operator-p e 'maxima::mequal)) (rest tail))))))

(defun needs-in (form)
  (cond ((atom form) '())
        ((anmech::operator-p form 'maxima::$anmech_need) (remove-if-not #'stringp (rest form)))
        (t (append (needs-in (car form)) (needs-in (cdr form))))))

(defun helper-name-p (symbol)
  (eql 0 (search "$ANMECH_" (symbol-name symbol))))

(defparameter *takers-of-functions*
  '(maxima::$map maxima::$apply maxima::$every maxima::$some maxima::$sublist maxima::$matrixmap maxima::$xreduce
    maxima::$lreduce maxima::$anmech_bound maxima::$anmech_call maxima::$anmech_map))

(defun uses-in (form)
  "Helpers wherever they stand; other functions where they are called, or handed to a function that calls them."
  (cond ((null form) '())
        ((symbolp form) (and (helper-name-p form) (list form)))
        ((atom form) '())
        ((and (consp (car form)) (symbolp (caar form)))
         (cons (caar form)
               (loop for part in (rest form)
                     append (if (and (anmech::operator-p part 'maxima::mquote) (symbolp (second part))
                                     (member (caar form) *takers-of-functions*))
                                (list (second part))
                                (uses-in part)))))
        (t (append (uses-in (car form)) (uses-in (cdr form))))))

;;; Kernel files.  A backquoted form is read as the list that it looks like.

(defvar *plain-readtable*
  (let ((table (copy-readtable nil)))
    (set-macro-character #\` (lambda (stream char)
                               (declare (ignore char))
                               (list 'quasi (read stream t nil t)))
                         nil table)
    (set-macro-character #\, (lambda (stream char)
                               (declare (ignore char))
                               (when (member (peek-char nil stream) '(#\@ #\.)) (read-char stream))
                               (read stream t nil t))
                         nil table)
    table))

(defun forms-of (file)
  (with-open-file (stream file)
    (let ((*package* (find-package :anmech)) (*readtable* *plain-readtable*) (*read-eval* nil))
      (loop for form = (read stream nil)
            while form
            when (and (eq (first form) 'defpackage) (not (find-package (second form))))
              do (eval form)
            when (eq (first form) 'in-package)
              do (setq *package* (or (find-package (second form)) *package*))
            collect form))))

(defun kernel-source (file)
  (let ((forms (forms-of file)))
    (make-source :file file
                 :name (name-of-file file)
                 :header (header-of file)
                 :needs (kernel-needs forms)
                 :defined (loop for form in forms append (names-of-definition form))
                 :used (remove-duplicates (loop for form in forms append (lisp-uses form))))))

(defun kernel-needs (forms)
  (loop for form in forms
        when (eq (first form) 'anmech::needs)
          append (mapcar (lambda (name) (concatenate 'string name ".lisp")) (rest form))))

(defun names-of-definition (form)
  (destructuring-bind (operator &optional head &rest parts) form
    (let ((name (if (consp head) (first head) head)))
      (case operator
        ((defun defmacro defgeneric defvar defparameter defconstant deftype define-condition
          maxima::defmfun maxima::defmspec)
         (list name))
        (defstruct (names-of-structure name (if (consp head) (rest head) '()) parts))))))

(defun names-of-structure (name options slots)
  (let* ((prefix (second (find-if (lambda (option) (and (consp option) (eq (first option) :conc-name))) options)))
         (prefix (or prefix (joined-name name name "-"))))
    (list* name (joined-name name "MAKE-" name) (joined-name name name "-P")
           (loop for slot in slots
                 unless (stringp slot)
                   collect (joined-name name prefix (if (consp slot) (first slot) slot))))))

(defun joined-name (like &rest parts)
  (intern (format nil "~{~a~}" (mapcar #'string parts)) (symbol-package like)))

(defun lisp-uses (form)
  "Symbols of the package in FORM that may stand for what other files define: called, quoted, #'named, special
variables.  Variables that the form binds are left out, by where they stand."
  (labels ((walk (form)
             (cond ((symbolp form) (and (global-name-p form) (list form)))
                   ((atom form) '())
                   (t (walk-call (car form) (cdr form)))))
           (walk-all (forms) (loop for rest = forms then (cdr rest)
                                   while (consp rest)
                                   append (walk (car rest))))
           (walk-bindings (bindings)
             (loop for binding in bindings when (consp binding) append (walk-all (rest binding))))
           (walk-loop (parts)
             (loop for (before part) on (cons nil parts)
                   unless (and (symbolp before) (member before '(for with and as) :test #'string=))
                     append (walk part)))
           (walk-call (head arguments)
             (cond ((consp head) (append (walk head) (walk-all arguments)))
                   ((member head '(let let* do do* symbol-macrolet))
                    (append (walk-bindings (first arguments)) (walk-all (rest arguments))))
                   ((member head '(flet labels macrolet))
                    (let ((own (mapcar #'first (first arguments))))
                      (set-difference (append (walk-bindings (mapcar #'rest (first arguments)))
                                              (walk-all (rest arguments)))
                                      own)))
                   ((member head '(defun defmacro maxima::defmfun maxima::defmspec deftype))
                    (walk-all (cddr arguments)))
                   ((member head '(lambda multiple-value-bind destructuring-bind))
                    (walk-all (rest arguments)))
                   ((eq head 'defstruct) (walk-bindings (remove-if-not #'consp (rest arguments))))
                   ((member head '(case ecase)) (append (walk (first arguments))
                                                        (loop for clause in (rest arguments)
                                                              append (walk-all (rest clause)))))
                   ((eq head 'cond) (loop for clause in arguments append (walk-all clause)))
                   ((member head '(dolist dotimes)) (append (walk-all (rest (first arguments)))
                                                            (walk-all (rest arguments))))
                   ((eq head 'loop) (walk-loop arguments))
                   ((member head '(catch throw)) (walk-all (rest arguments)))
                   ((member head '(quote function))
                    (if (symbolp (first arguments)) (list (first arguments)) (walk (first arguments))))
                   (t (cons head (walk-all arguments))))))
    (walk form)))

(defun global-name-p (symbol)
  "Special variables and constants, functions that modules see, and names of types."
  (let ((name (symbol-name symbol)))
    (or (helper-name-p symbol)
        (and (> (length name) 2) (find (char name 0) "*+") (char= (char name 0) (char name (1- (length name)))))
        (member name '("DOUBLE-ARRAY") :test #'string=))))
