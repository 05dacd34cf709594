;;;; names.lisp: what rtest_names.mac asks.
;;;;
;;;;   names_defined_twice()    [name, file, file, ...] of each name that two files of the package define, modules
;;;;                            (.mac) or files of the kernel (.lisp), or one file twice
;;;;   locals_not_used()        [function, local, ...] of each function of a module with locals that nothing uses
;;;;   lines_too_long()         [file, line] of each line of code that is longer than 120 characters
;;;;   types_out_of_place()     [file, variable] of each type that a file of the kernel declares elsewhere than where
;;;;                            the variable is bound; and of each that is bound to a number of a type, and has none
;;;;
;;;; Of two definitions of one name the one that happens to be read later holds, for all files.  Heads of structures
;;;; and what the macro defstruct makes of a name count too; a structure may have its constructor beside it.

(in-package :anmech-tests)

(load (concatenate 'string *root* "rtest/sources.lisp"))

(defun twice-defined (sources)
  (let ((places (make-hash-table)))
    (dolist (source sources)
      (dolist (name (append (source-defined source)
                            (set-difference (source-structures source) (source-defined source))))
        (push (source-name source) (gethash name places))))
    (loop for name being the hash-keys of places using (hash-value found)
          when (rest found)
            collect (list* '(maxima::mlist maxima::simp) (text-of name) (reverse found)))))

;;; A loaded definition's locals are private symbols, different from all others.

(defun private-symbol-p (form)
  (and (symbolp form) (find #\` (symbol-name form))))

(defun block-locals (form)
  "The private symbols that blocks in FORM declare."
  (if (atom form)
      '()
      (append (when (anmech::operator-p form 'maxima::mprog)
                (remove-if-not #'private-symbol-p
                               (loop for local in (rest (second form))
                                     collect (if (consp local) (second local) local))))
              (block-locals (car form))
              (block-locals (cdr form)))))

(defun occurrences (symbol form)
  (cond ((eq symbol form) 1)
        ((atom form) 0)
        (t (+ (occurrences symbol (car form)) (occurrences symbol (cdr form))))))

(defun locals-not-used (definition)
  (let ((form (anmech::definition-lambda definition)))
    (remove-if-not (lambda (local) (= 1 (occurrences local form))) (block-locals form))))

(defun all-definitions ()
  (dolist (source (sources))
    (unless (kernel-file-p (source-file source)) (anmech::need-module (source-name source))))
  (let ((definitions '()))
    (do-symbols (symbol :maxima)
      (let ((definition (anmech::definition-of symbol)))
        (when definition (pushnew definition definitions))))
    definitions))

;;; GCL takes the type of a variable only where it is bound: elsewhere it says nothing, and boxes every number.  Nor
;;; does it find out the type itself.

(defun all-symbols (form)
  (if (consp form) (append (all-symbols (car form)) (all-symbols (cdr form))) (and form (symbolp form) (list form))))

(defun names-bound-by (form)
  "The names that FORM binds, and the forms that may begin with declarations of them; :none if it binds no variables."
  (destructuring-bind (head &optional first second &rest more) form
    (case head
      ((let let*) (values (mapcar (lambda (binding) (if (consp binding) (first binding) binding)) first)
                          (cons second more)))
      ((defun) (values (all-symbols second) more))
      ((lambda) (values (all-symbols first) (cons second more)))
      ((multiple-value-bind destructuring-bind) (values (all-symbols first) more))
      ((do do*) (values (mapcar #'first first) more))
      (t :none))))

(defparameter *not-types* '(ignore ignorable optimize special dynamic-extent inline notinline ftype))

(defun typed-in (forms)
  "The variables to which the declarations give types that stand among the first of FORMS."
  (loop for form in (member-if-not #'stringp forms)
        while (and (consp form) (eq (first form) 'declare))
        append (loop for declaration in (rest form)
                     when (and (consp declaration) (not (member (first declaration) *not-types*)))
                       append (remove-if-not #'symbolp
                                             (if (eq (first declaration) 'type)
                                                 (cddr declaration)
                                                 (rest declaration))))))

(defun numbers-without-types (form)
  "The variables that FORM, of let, binds to numbers by the macros that are there to keep these unboxed."
  (when (member (first form) '(let let*))
    (let ((typed (typed-in (cddr form))))
      (loop for (name value) in (remove-if-not #'consp (second form))
            when (and (consp value) (member (first value) '(anmech::flo anmech::fix)) (not (member name typed)))
              collect name))))

(defun types-out-of-place (form)
  "The variables in FORM; what a backquoted form is to become is not known."
  (cond ((or (atom form) (member (car form) '(quote quasi))) '())
        ((member (car form) '(flet labels))
         (append (loop for (nil . function) in (second form) append (types-out-of-place (cons 'lambda function)))
                 (types-out-of-parts (cddr form))))
        (t (append (and (symbolp (car form)) (consp (cdr form)) (listp (cdr (last form)))
                        (multiple-value-bind (names body) (names-bound-by form)
                          (and (listp names)
                               (append (set-difference (typed-in body) names) (numbers-without-types form)))))
                   (types-out-of-parts form)))))

(defun types-out-of-parts (forms)
  (loop for rest = forms then (cdr rest)
        while (consp rest)
        append (types-out-of-place (car rest))))

(defun lines-such-that (test file)
  "The numbers of the lines of FILE that TEST holds of."
  (with-open-file (stream file)
    (loop for line = (read-line stream nil)
          for number from 1
          while line
          when (funcall test line)
            collect number)))

(defun places-such-that (test patterns)
  "Lists of a file and the number of a line that TEST holds of."
  (loop for pattern in patterns
        append (loop for file in (files-of pattern)
                     append (loop for number in (lines-such-that test file)
                                  collect (list '(maxima::mlist maxima::simp) (file-namestring file) number)))))

(in-package :maxima)

(defmfun $locals_not_used ()
  (let ((definitions (anmech-tests::all-definitions)))         ; loads the kernel, maxima-list with it
    (anmech::maxima-list
     (loop for definition in definitions
           for locals = (anmech-tests::locals-not-used definition)
           when locals
             collect (anmech::maxima-list
                      (mapcar #'anmech-tests::text-of (cons (anmech::definition-name definition) locals)))))))

(defmfun $names_defined_twice ()
  (cons '(mlist simp) (anmech-tests::twice-defined (anmech-tests::sources))))

(defmfun $lines_too_long ()
  (cons '(mlist simp)
        (anmech-tests::places-such-that
         (lambda (line) (> (length line) 120))
         '("share/anmech/**/*.mac" "src/**/*.lisp" "rtest/*.mac" "rtest/*.lisp" "rtest/setup/*.sh"))))

;;; stringp and simplode load a package of Maxima's, which takes SBCL more than half a second: texts.lisp has others.
(defmfun $uses_of_string_package ()
  (cons '(mlist simp)
        (anmech-tests::places-such-that
         (lambda (line) (or (search "stringp" line) (search "simplode" line)))
         '("share/anmech/**/*.mac"))))

(defmfun $types_out_of_place ()
  (cons '(mlist simp)
        (loop for file in (anmech-tests::kernel-files)
              append (loop for name in (anmech-tests::types-out-of-parts (anmech-tests::forms-of file))
                           collect (list '(mlist simp) (file-namestring file) (anmech-tests::text-of name))))))

(defmfun $types_out_of_place_in (text)
  (let ((form (let ((*package* (find-package :anmech))) (read-from-string text))))
    (cons '(mlist simp) (mapcar #'anmech-tests::text-of (anmech-tests::types-out-of-place form)))))
