;;;; names.lisp: what rtest_names.mac asks.
;;;;
;;;;   names_defined_twice()    [name, file, file, ...] of each name that two modules (.mac), two files of the kernel
;;;;                            (.lisp), or the same file twice define
;;;;
;;;; Modules and kernel files are read as late as possible, so of two definitions of one name the one that happens to
;;;; come later holds, for all files.  What the macro defstruct makes of a name counts too.

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

(defun twice-defined (files definitions)
  "FILES is a list of names, DEFINITIONS a function that gives what one of them defines."
  (let ((places (make-hash-table)))
    (dolist (file files)
      (dolist (name (funcall definitions file))
        (push (file-namestring file) (gethash name places))))
    (loop for name being the hash-keys of places using (hash-value found)
          when (rest found)
            collect (list* '(maxima::mlist maxima::simp) (text-of name) (reverse found)))))

(in-package :maxima)

(defmfun $names_defined_twice ()
  (cons '(mlist simp)
        (append (anmech-tests::twice-defined (anmech-tests::files-of "share/anmech/*.mac")
                                             #'anmech-tests::definitions-in-module)
                (anmech-tests::twice-defined (anmech-tests::files-of "src/*.lisp")
                                             #'anmech-tests::definitions-in-kernel))))
