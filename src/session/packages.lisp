;;; anmech: Maxima's share packages that a verb makes use of.
;;;
;;; Such a package defines functions and sets variables under plain names, `reduce', `exact' or `method', which may be
;;; the user's.  So what it defines is taken off again as soon as it is loaded, and put on only while one of its
;;; functions works; the user's variables have no values then, since it is written for such a session.
;;;
;;; Entry points: anmech_package_loaded, anmech_alone; CALL-AMONG-PACKAGES.

(in-package :anmech)
(needs "session/attempt" "session/libraries" "session/outcomes")

(defvar *packages* '() "The share packages that were asked for: conses of a name and whether it is there.")
(defvar *package-definitions* '() "What these packages have defined: lists of a symbol, its function and its macro.")
(defvar *package-values* '() "Conses of the variables that they have set and the values.")

(defparameter *information-lists*
  '(maxima::$functions maxima::$macros maxima::$values maxima::$props maxima::$rules maxima::$aliases
    maxima::$dependencies maxima::$gradefs)
  "Where Maxima lists what was defined.")

(defun definitions ()
  "All functions and macros written in Maxima's language, also those that Maxima loads when they are first called: a
table from symbols to (function macro)."
  (let ((table (make-hash-table :test 'eq)))
    (do-symbols (symbol :maxima table)
      (let ((function (maxima::mget symbol 'maxima::mexpr))
            (macro (maxima::mget symbol 'maxima::mmacro)))
        (when (or function macro) (setf (gethash symbol table) (list function macro)))))))

(defun define-as (symbol function macro)
  (loop for (what definition) in `((maxima::mexpr ,function) (maxima::mmacro ,macro))
        do (if definition
               (maxima::mputprop symbol definition what)
               (maxima::mremprop symbol what))))

(defun take-off-definitions (before)
  "Put back what was defined BEFORE, and remember what was defined since."
  (setq *package-definitions* '())
  (maphash (lambda (symbol now)
             (let ((then (gethash symbol before)))
               (unless (and (eq (first now) (first then)) (eq (second now) (second then)))
                 (push (cons symbol now) *package-definitions*)
                 (define-as symbol (first then) (second then)))))
           (definitions)))

(defun take-off-values ()
  (let ((variables (user-variables)))
    (setq *package-values* (mapcar (lambda (variable) (cons variable (symbol-value variable))) variables))
    (mapc #'makunbound variables)))

(defun user-variables ()
  "The variables with a value that are none of Maxima's own."
  (remove-if (lambda (variable) (or (not (boundp variable)) (gethash variable maxima::*variable-initial-values*)))
             (rest maxima::$values)))

;;; (GCL cannot compile a progv of unknown symbols.)
(defun call-among-packages (thunk)
  "The value of THUNK in a session of the packages alone; whatever THUNK defines belongs to them."
  (let* ((lists (mapcar #'symbol-value *information-lists*))
         (variables (user-variables))
         (saved (mapcar #'symbol-value variables))
         (before (definitions))
         (maxima::dsksetp nil))                 ; what they assign to is to be listed, whatever guard.lisp says
    (unwind-protect
         (progn (loop for name in *information-lists* do (set name (copy-list (symbol-value name))))
                (mapc #'makunbound variables)
                (loop for (variable . value) in *package-values* do (set variable value))
                (setq maxima::$values (cons '(maxima::mlist maxima::simp) (mapcar #'first *package-values*)))
                (loop for (symbol function macro) in *package-definitions* do (define-as symbol function macro))
                (funcall thunk))
      (take-off-definitions before)
      (take-off-values)
      (mapc #'set *information-lists* lists)
      (mapc #'set variables saved))))

(defun load-package (name)
  "Whether the share package NAME could be loaded; in silence."
  (let ((*standard-output* (make-broadcast-stream)))
    (call-with-library
     (lambda ()
       (call-among-packages
        (lambda () (not (not-found-p (maxima::meval `((maxima::$anmech_attempt) ((maxima::$load) ,name)))))))))))

(defun package-loaded-p (name)
  (rest (or (assoc name *packages* :test #'string=)
            (first (push (cons name (load-package name)) *packages*)))))

(maxima::defmfun maxima::$anmech_package_loaded (name)
  "anmech_package_loaded(\"contrib_ode\"): whether this share package is there, which is loaded when first asked for."
  (package-loaded-p name))

(maxima::defmspec maxima::$anmech_alone (form)
  "anmech_alone(f(x, y)): the value of f, a function of a share package or of ode2, which others call, at the values of
x and y, computed in silence and among the packages alone."
  (let* ((call (second form))
         (arguments (mapcar #'maxima::meval (rest call))))
    (package-loaded-p "ode2")
    (let ((*standard-output* (make-broadcast-stream)))
      (call-with-library
       (lambda () (call-among-packages (lambda () (apply #'maxima::mfuncall (caar call) arguments))))))))
