;;; anmech: facts of our own, in a context above the user's.
;;;
;;; Entry points: WITH-OWN-CONTEXT; anmech_in_own_context.

(in-package :anmech)
(needs "session/prepared_code")

(defmacro with-own-context (&body body)
  "BODY in a context above the present one, which is gone at the end, however that comes."
  `(let ((outer maxima::$context) (own (maxima::$supcontext)))
     (unwind-protect (progn ,@body)
       (maxima::meval (list '(maxima::msetq) 'maxima::$context (list '(maxima::mquote) outer)))
       (maxima::$killcontext own))))

(maxima::defmspec maxima::$anmech_in_own_context (form)
  "anmech_in_own_context(expr): the value of expr; what is assumed in it is forgotten."
  (with-own-context (maxima::meval (second form))))

(define-handed-on maxima::$anmech_in_own_context)
