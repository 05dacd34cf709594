;;; anmech: answers to what Maxima asks of parameters, for results that are checked afterwards.
;;;
;;; Entry point: anmech_attempt_answered.
;;;
;;; integrate asks for the sign of a discriminant, or whether an exponent is -1, and gives one of several formulas; each
;;; is an antiderivative wherever it makes sense, also for parameters of another sign (an arc tangent turns into a
;;; logarithm by itself). So any answer will do that is generic, if the result is then differentiated.

(in-package :anmech)
(needs "session/attempt" "session/guard" "session/interposed" "session/prepared_code")

(defparameter *most-answers* 20 "More questions than these, and something is wrong.")

(defun generic-answer (message)
  "What to answer to Maxima's question MESSAGE, a string: nothing is equal, nothing is an integer, all is positive."
  (cond ((or (search "equal" message) (search "integer" message)) 'maxima::$no)
        ((search "zero or nonzero" message) 'maxima::$nonzero)
        ((search "positive" message) 'maxima::$positive)
        ((search "negative" message) 'maxima::$negative)
        (t 'maxima::$no)))

(defun question-text (message)
  "The words of MESSAGE, whatever it asks about."
  (format nil "~{~a~}" (remove-if-not #'stringp (if (consp message) (rest message) (list message)))))

(defun few-generic-answers ()
  "A function that answers some questions."
  (let ((left *most-answers*))
    (lambda (message flag &rest more)
      (if (minusp (decf left))
          (apply #'no-question message flag more)
          (generic-answer (question-text message))))))

(maxima::defmspec maxima::$anmech_attempt_answered (form)
  "anmech_attempt_answered(expr): as anmech_attempt, but Maxima's questions have generic answers, which are forgotten at
the end."
  (let ((maxima::*local-signs* '()))
    (unwind-protect (let ((*answering* (few-generic-answers)))
                      (interpose 'maxima::retrieve '*answering*)
                      (maxima::meval `((maxima::$anmech_attempt) ,(second form))))
      (maxima::clearsign))))

(define-handed-on maxima::$anmech_attempt_answered)
