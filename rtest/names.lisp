;;;; names.lisp: what rtest_names.mac asks.
;;;;
;;;;   names_defined_twice()    [name, file, file, ...] of each name that two files of the package define, modules
;;;;                            (.mac) or files of the kernel (.lisp), or one file twice
;;;;   locals_not_used()        [function, local, ...] of each function of a module with locals that nothing uses
;;;;   lines_too_long()         [file, line] of each line of code that is longer than 120 characters
;;;;
;;;; Modules and kernel files are read as late as possible, so of two definitions of one name the one that happens to
;;;; come later holds, for all files.  A function that the kernel gives to modules shares their space of names.  What
;;;; the macro defstruct makes of a name counts too.

(in-package :anmech-tests)

(defun definitions-in-module (file)
  (with-open-file (stream file)
    (loop for statement = (next-expression stream)
          while statement
          when (anmech::operator-p (third statement) 'maxima::mdefine)
            collect (caar (second (third statement))))))

(defun definitions-in-kernel (file)
  (with-open-file (stream file)
    (let ((*package* (find-package :anmech)) (*read-eval* nil))
      (loop for form = (read stream nil)
            while form
            when (eq (first form) 'in-package)
              do (setq *package* (or (find-package (second form)) *package*))
            append (names-of-definition form)))))

(defun names-of-definition (form)
  (destructuring-bind (operator &optional head &rest parts) form
    (let ((name (if (consp head) (first head) head)))
      (case operator
        ((defun defmacro defgeneric defvar defparameter defconstant maxima::defmfun maxima::defmspec) (list name))
        (defstruct (names-of-structure name (if (consp head) (rest head) '()) parts))))))

(defun names-of-structure (name options slots)
  (let ((prefix (or (second (find-if (lambda (option) (and (consp option) (eq (first option) :conc-name))) options))
                    (joined-name name "-"))))
    (list* name (joined-name "MAKE-" name) (joined-name name "-P")
           (loop for slot in slots
                 unless (stringp slot)
                   collect (joined-name prefix (if (consp slot) (first slot) slot))))))

(defun joined-name (&rest parts)
  (intern (format nil "~{~a~}" (mapcar #'string parts))))

(defun files-of (pattern)
  (sort (mapcar #'namestring (directory (concatenate 'string *root* pattern))) #'string<))

(defun definitions-in (file)
  (if (search ".lisp" file) (definitions-in-kernel file) (definitions-in-module file)))

(defun twice-defined (files)
  (let ((places (make-hash-table)))
    (dolist (file files)
      (dolist (name (definitions-in file))
        (push (file-namestring file) (gethash name places))))
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
  (dolist (file (files-of "share/anmech/*.mac"))
    (unless (string= (pathname-name file) "anmech") (anmech::need-module (pathname-name file))))
  (let ((definitions '()))
    (do-symbols (symbol :maxima)
      (let ((definition (anmech::definition-of symbol)))
        (when definition (pushnew definition definitions))))
    definitions))

(defun long-lines (file longest)
  "The numbers of the lines of FILE with more characters than LONGEST."
  (with-open-file (stream file)
    (loop for line = (read-line stream nil)
          for number from 1
          while line
          when (> (length line) longest)
            collect number)))

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
  (cons '(mlist simp)
        (anmech-tests::twice-defined (append (anmech-tests::files-of "share/anmech/*.mac")
                                             (anmech-tests::files-of "src/*.lisp")))))

(defmfun $lines_too_long ()
  (cons '(mlist simp)
        (loop for pattern in '("share/anmech/*.mac" "src/*.lisp" "rtest/*.mac" "rtest/*.lisp" "rtest/setup/*.sh")
              append (loop for file in (anmech-tests::files-of pattern)
                           append (loop for number in (anmech-tests::long-lines file 120)
                                        collect (list '(mlist simp) (file-namestring file) number))))))
