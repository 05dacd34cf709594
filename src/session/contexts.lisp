;;; anmech: facts of our own, in a context above the user's.
;;;
;;; Entry points: WITH-OWN-CONTEXT; anmech_in_own_context.

(in-package :anmech)
(needs "session/prepared_code")

(defvar *free-contexts* '() "Names of contexts that are not in use.")

(defun new-context ()
  "A new context above the present one, by a name that was used before: those that Maxima makes up are kept for ever."
  (maxima::$supcontext (or (pop *free-contexts*) (make-symbol "$ANMECH_CONTEXT"))))

(defun leave-context (own outer)
  (maxima::meval (list '(maxima::msetq) 'maxima::$context (list '(maxima::mquote) outer)))
  (maxima::$killcontext own)
  (unless (member own (rest maxima::$contexts)) (push own *free-contexts*)))

(defmacro with-own-context (&body body)
  "BODY in a context above the present one, which is gone at the end, however that comes."
  `(let ((outer maxima::$context) (own (new-context)))
     (unwind-protect (progn ,@body)
       (leave-context own outer))))

(maxima::defmspec maxima::$anmech_in_own_context (form)
  "anmech_in_own_context(expr): the value of expr; what is assumed in it is forgotten."
  (with-own-context (maxima::meval (second form))))

(define-handed-on maxima::$anmech_in_own_context)
