;;; anmech: asking Maxima for something that it may not be able to give.
;;;
;;; Entry points: anmech_attempt, anmech_or_sentence, anmech_silently.

(in-package :anmech)
(needs "session/guard" "session/outcomes" "session/patience" "session/prepared_code" "session/texts")

(maxima::defmspec maxima::$anmech_attempt (form)
  "anmech_attempt(expr): the value of expr; not found if its evaluation fails: by an error, or by a question, which
under the guard of a verb is an error, or by a recursion without end, which Maxima's integrate is capable of.  For
integrate and solve, where failing is an answer; nothing is printed or left behind."
  (let ((maxima::$errormsg nil) (maxima::$error maxima::$error))
    (let ((answer (maxima::errcatch
                    (handler-case (call-interruptibly (lambda () (maxima::meval (second form))))
                      (storage-condition () (maxima::merror "the recursion does not end"))))))
      (if answer (first answer) (maxima::$anmech_not_found 'maxima::$failed)))))

(maxima::defmspec maxima::$anmech_or_sentence (form)
  "anmech_or_sentence(expr): the value of expr, or a text that tells the error it ends with: for tables, in which what
goes wrong with one row is said and does not keep the others."
  (let ((maxima::$errormsg nil) (maxima::$error maxima::$error))
    (handler-case (with-maxima-errors (maxima::meval (second form)))
      (maxima::maxima-$error () (text-of-error)))))

(maxima::defmspec maxima::$anmech_silently (form)
  "anmech_silently(expr): the value of expr; what the libraries behind Maxima print on the way is lost."
  (let ((*standard-output* (make-broadcast-stream)))
    (maxima::meval (second form))))

(define-handed-on maxima::$anmech_attempt maxima::$anmech_or_sentence maxima::$anmech_silently)
