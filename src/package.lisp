;;; anmech: the kernel's package, and how a file of the kernel is compiled once and loaded.
;;;
;;; Copyright (C) 2026 the anmech authors.  Licence: GPL-2.0-or-later.
;;;
;;; The kernel lives in a package of its own: in :maxima some two hundred plain words (name, size, depth, current ...)
;;; are global dynamic variables, and exp, tan, float, gcd ... are not Common Lisp's.  Maxima's symbols are written with
;;; their package (maxima::mplus, maxima::$x); what Maxima is to see as a function is defined with maxima::defmfun.
;;;
;;; Entry points: anmech::load-kernel, anmech::terminal-p, anmech_compile_kernel.  This file is always interpreted, so
;;; it is small.

(in-package :cl-user)

(defpackage :anmech
  (:use :common-lisp))

(in-package :anmech)

(defvar *source-directory* nil
  "Directory of the kernel's sources, with its final slash: a namestring.")

(defvar *loaded-files* '()
  "Names of the kernel files that this session has loaded.")

(defun source-file (name &optional (suffix "lisp"))
  (concatenate 'string *source-directory* name "." suffix))

(defun binary-file (name)
  "Where the compiled NAME is kept: among Maxima's own objects, apart for each place that the sources may lie in."
  (let ((place (format nil "~a/anmech-~36r/" maxima::$maxima_objdir (sxhash *source-directory*))))
    (namestring (merge-pathnames (concatenate 'string place name)
                                 (compile-file-pathname (source-file name))))))

(defun in-folder-p (source folders)
  (and (member (first (last (pathname-directory source))) folders :test #'equal) t))

(defparameter *inner-loops*
  '("comparison" "evaluation" "integration" "noise" "registers" "series_kernel" "steps" "switching")
  "Files of numerics/ in which motions spend their time.")

(defun inner-loops-p (source)
  "Whether a kernel file is worth the C compiler's optimization, which on GCL takes three quarters of the time."
  (or (in-folder-p source '("arithmetic" "integrators"))
      (and (in-folder-p source '("numerics")) (member (pathname-name source) *inner-loops* :test #'equal))))

(defun numbers-p (source)
  "Whether a kernel file works on numbers alone: there GCL reads slots of structures where they are, not by a call that
looks first whether the structure is one of that kind, as Maxima asks of it."
  (in-folder-p source '("arithmetic" "numerics" "integrators")))

(defun compiler-p ()
  "Whether files can be compiled at all: ECL may have come without the C headers that it needs."
  #+ecl (let ((headers (find-symbol "*ECL-INCLUDE-DIRECTORY*" :c)))
          (or (null headers)
              (probe-file (concatenate 'string (namestring (symbol-value headers)) "ecl/ecl.h"))))
  #-ecl t)

(defun compile-quietly (source target)
  "Compile SOURCE to TARGET, saying nothing.  The binary's path, or nil where there is no compiler to be had."
  (let* ((silence (make-broadcast-stream))
         #+gcl (si::*notify-gbc* nil)
         #+gcl (compiler::*compile-verbose* nil)
         #+gcl (compiler::*safe-compile* (not (numbers-p source)))
         #+gcl (compiler::*opt-three* (if (inner-loops-p source) compiler::*opt-three* "-O0")))
    (let ((*standard-output* silence) (*error-output* silence) (*trace-output* silence)
          (*compile-verbose* nil) (*compile-print* nil) (*load-verbose* nil))
      (handler-case
          (multiple-value-bind (binary warned failed) (compile-file source :output-file target)
            (declare (ignore warned))
            (and binary #+ecl (not failed) #-ecl (progn failed t) (probe-file binary) (namestring binary)))
        (error () nil)))))

(defun terminal-p ()
  "Whether somebody sees at once what is written.  Only SBCL knows it by itself."
  #+sbcl (interactive-stream-p *standard-output*)
  #-sbcl (handler-case (eql 0 (#+gcl si:system #+ecl ext:system #-(or gcl ecl) identity "test -t 1"))
           (error () nil)))

(defvar *told-of-compiling* nil)

(defun tell-of-compiling ()
  "One line in a session for somebody who waits at a prompt, or at wxMaxima."
  (unless *told-of-compiling*
    (setq *told-of-compiling* t)
    (when (or (fboundp 'maxima::$wxstatusbar) (terminal-p))
      (format t "~&anmech: compiling its kernel, once; this takes some seconds.~%")
      (finish-output))))

(defun process-number ()
  #+gcl (si::getpid) #+sbcl (sb-unix:unix-getpid) #+ecl (ext:getpid)
  #-(or gcl sbcl ecl) (random most-positive-fixnum (make-random-state t)))

(defun compile-once (name)
  "The path of a fresh binary of kernel file NAME, compiled if need be; nil if it cannot be compiled here.
A binary is written under a passing name and then renamed, since two sessions may do this at once."
  (let ((binary (binary-file name)))
    (cond
      ((fresh-p name) binary)
      ((compiler-p)
       (let ((passing (format nil "~a-~36r~a" (subseq binary 0 (position #\. binary :from-end t))
                              (process-number)
                              (subseq binary (position #\. binary :from-end t)))))
         (tell-of-compiling)
         (handler-case
             (progn
               (ensure-directories-exist binary)
               (let ((made (compile-quietly (source-file name) passing)))
                 (when made
                   (rename-file made binary)
                   binary)))
           (error () nil)))))))

(defmacro needs (&rest names)
  "The kernel files that this one stands on, the first form after in-package."
  `(eval-when (:load-toplevel :execute)
     (mapc #'load-kernel ',names)))

(defun needs-of (name)
  "What kernel file NAME says it needs."
  (with-open-file (stream (source-file name))
    (let ((*package* (find-package :anmech)))
      (loop for form = (read stream nil)
            while (and form (member (first form) '(in-package needs)))
            when (eq (first form) 'needs) return (rest form)))))

(defvar *source-dates* (make-hash-table :test 'equal)
  "When each kernel file, or one that it stands on, was last written, as this session first saw it.")

(defun source-date (name)
  "The newest date of kernel file NAME and of all that it stands on: files use one another's macros and structures."
  (or (gethash name *source-dates*)
      (setf (gethash name *source-dates*)
            (reduce #'max (mapcar #'source-date (needs-of name))
                    :initial-value (max (file-write-date (source-file name))
                                        (file-write-date (source-file "package")))))))

(defun fresh-p (name)
  "Whether the binary of kernel file NAME is younger than all that it was made of."
  (let ((binary (binary-file name)))
    (and (probe-file binary)
         (> (file-write-date binary) (source-date name)))))

(defun load-kernel (name)
  "Load kernel file NAME unless it is here already: its binary, or the source where no compiler is at hand.  To be
compiled, a file wants the macros of those that it needs."
  (unless (member name *loaded-files* :test #'string=)
    (let ((*load-verbose* nil) (*package* (find-package :cl-user)))
      (unless (fresh-p name) (mapc #'load-kernel (needs-of name)))
      (load (or (compile-once name) (source-file name))))
    (push name *loaded-files*))
  t)

(defun kernel-files ()
  "The names of all."
  (let ((start (length *source-directory*)))
    (remove "package"
            (mapcar (lambda (path) (subseq (namestring path) start (- (length (namestring path)) (length ".lisp"))))
                    (directory (source-file "**/*")))
            :test #'string=)))

(maxima::defmfun maxima::$anmech_compile_kernel ()
  "anmech_compile_kernel(): compile all kernel files that are not compiled yet; for the installation."
  (mapc #'load-kernel (kernel-files))
  'maxima::$done)

(defvar *module-directory* nil
  "Directory of the package's .mac files, with its final slash: a namestring.")

(defparameter *session-files* '("session/verbs" "session/structures" "session/memory" "session/outcomes"
                                "session/prompt")
  "What is there from the start, with what these need.")

(maxima::defmfun maxima::$anmech_start (modules sources)
  "anmech_start(modules, sources): begin; MODULES is the directory of the front door, SOURCES that of the kernel."
  (setq *module-directory* (namestring (truename modules))
        *source-directory* (namestring (truename sources)))
  (mapc #'load-kernel *session-files*)
  'maxima::$done)
