;;; anmech: Maxima's share packages that a verb makes use of.
;;;
;;; Such a package is written for a session in which its own variables have no values; so the user's are out of sight
;;; while it works.
;;;
;;; Entry points: anmech_package_loaded, anmech_alone.

(in-package :anmech)
(needs "session/attempt" "session/outcomes")

(defvar *packages* '() "The share packages that were asked for: conses of a name and whether it is there.")
(defvar *package-variables* '() "The variables to which these packages have given values.")

(defun load-package (name)
  "Whether the share package NAME could be loaded; in silence."
  (let ((before (rest maxima::$values))
        (*standard-output* (make-string-output-stream)))
    (prog1 (not (not-found-p (maxima::meval `((maxima::$anmech_attempt) ((maxima::$load) ,name)))))
      (setq *package-variables* (append (set-difference (rest maxima::$values) before) *package-variables*)))))

(maxima::defmfun maxima::$anmech_package_loaded (name)
  "anmech_package_loaded(\"contrib_ode\"): whether this share package is there, which is loaded when first asked for."
  (rest (or (assoc name *packages* :test #'string=)
            (first (push (cons name (load-package name)) *packages*)))))

(defun call-without-values (variables thunk)
  "The value of THUNK while VARIABLES have none.  (GCL cannot compile a progv of unknown symbols.)"
  (let ((saved (mapcar #'symbol-value variables)))
    (unwind-protect
         (progn (mapc #'makunbound variables) (funcall thunk))
      (mapc #'set variables saved))))

(maxima::defmspec maxima::$anmech_alone (form)
  "anmech_alone(f(x, y)): the value of f at the values of x and y, computed in silence and while the user's variables
have no values."
  (let* ((call (second form))
         (arguments (mapcar #'maxima::meval (rest call)))
         (*standard-output* (make-string-output-stream)))
    (call-without-values (remove-if-not #'boundp (set-difference (rest maxima::$values) *package-variables*))
                         (lambda () (apply #'maxima::mfuncall (caar call) arguments)))))
