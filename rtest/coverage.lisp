;;;; coverage.lisp: which functions of the package the tests call.  For make coverage.
;;;;
;;;; A run of tests with the variable COVERAGE, a directory, leaves there the names of what it called, one file for
;;;; each file of tests; not_covered(directory) prints those that no test called, file by file.  Functions of modules
;;;; are seen where the session calls them, those of the kernel by a wrapping around each: on SBCL, where every call of
;;;; a global function goes through its name.

(load (concatenate 'string anmech-tests::*root* "rtest/sources.lisp"))

(defpackage :anmech-coverage
  (:use :common-lisp)
  (:import-from :anmech-tests anmech-tests::sources anmech-tests::source-file anmech-tests::source-name
                anmech-tests::source-defined anmech-tests::kernel-file-p anmech-tests::forms-of))

(in-package :anmech-coverage)

(defvar *called* (make-hash-table :test #'eq))

(defun note-call (name) (setf (gethash name *called*) t))

(defun wrap (name wrapper)
  "Call WRAPPER with the function NAME and its arguments, in the place of NAME."
  (let ((function (symbol-function name)))
    (setf (symbol-function name) (lambda (&rest arguments) (funcall wrapper function arguments)))))

;;; Kernel functions are wrapped when their file has come in.

(defun kernel-functions ()
  "A list of (name . source)."
  (loop for source in (sources)
        when (kernel-file-p (source-file source))
          append (loop for form in (forms-of (source-file source))
                       when (member (first form) '(defun maxima::defmfun maxima::defmspec))
                         collect (cons (second form) source))))

(defvar *kernel-functions* nil)
(defvar *wrapped* (make-hash-table :test #'eq))

(defun watch (name)
  (let ((special (get name 'maxima::mfexpr*)))
    (cond (special
           (setf (gethash name *wrapped*) t
                 (get name 'maxima::mfexpr*) (lambda (form) (note-call name) (funcall special form))))
          ((and (symbolp name) (fboundp name) (not (macro-function name)))
           (setf (gethash name *wrapped*) t)
           (wrap name (lambda (function arguments) (note-call name) (apply function arguments)))))))

(defun watch-kernel ()
  (loop for (name) in *kernel-functions*
        unless (or (not (symbolp name)) (gethash name *wrapped*))
          do (watch name)))

(defun start-coverage ()
  (setq *kernel-functions* (kernel-functions))
  (watch-kernel)
  (wrap 'anmech::apply-to-all
        (lambda (function arguments)
          (note-call (anmech::definition-name (first arguments)))
          (apply function arguments)))
  (wrap 'anmech::load-kernel (lambda (function arguments) (prog1 (apply function arguments) (watch-kernel)))))

(defun end-coverage (directory file)
  (with-open-file (stream (format nil "~a/~a.calls" directory (pathname-name file))
                          :direction :output :if-exists :supersede)
    (loop for name being the hash-keys of *called*
          do (format stream "~s ~s~%" (package-name (symbol-package name)) (symbol-name name)))))

;;; What was not called

(defun read-calls (directory)
  (dolist (file (directory (concatenate 'string directory "/*.calls")))
    (with-open-file (stream file)
      (loop for package = (read stream nil)
            while package
            do (let ((name (find-symbol (read stream) package)))
                 (when name (note-call name)))))))

(defun defined-functions ()
  (append (kernel-functions)
          (loop for source in (sources)
                unless (kernel-file-p (source-file source))
                  append (mapcar (lambda (name) (cons name source)) (source-defined source)))))

(defun not-covered (directory)
  (let ((table '()) (defined (defined-functions)))      ; these names exist before calls of them are read
    (read-calls directory)
    (loop for (name . source) in defined
          unless (gethash name *called*)
            do (let ((row (assoc source table)))
                 (if row (push name (cdr row)) (push (list source name) table))))
    (loop for (source . names) in (nreverse table)
          collect (list (source-name source) (sort (mapcar #'plain-name names) #'string<)))))

(defun plain-name (name) (string-downcase (string-left-trim "$" (princ-to-string name))))

(in-package :maxima)

(defmfun $not_covered (directory)
  (let* ((rows (anmech-coverage::not-covered directory)) (all (length (anmech-coverage::defined-functions)))
         (missing (reduce #'+ rows :key (lambda (row) (length (second row))))))
    (loop for (file names) in rows
          do (format t "~a~%    ~{~a~^ ~}~%" file names))
    (format t "~d of ~d functions are called by tests~%" (- all missing) all)
    '$done))
