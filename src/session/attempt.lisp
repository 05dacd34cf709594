;;; anmech: asking Maxima for something that it may not be able to give.
;;;
;;; Entry points: anmech_attempt, anmech_silently.

(in-package :anmech)
(needs "session/outcomes" "session/patience")

(maxima::defmspec maxima::$anmech_attempt (form)
  "anmech_attempt(expr): the value of expr; not found if its evaluation fails: by an error, or by a question, which
under the guard of a verb is an error, or by a recursion without end, which Maxima's integrate is capable of.  For
integrate and solve, where failing is an answer; nothing is printed or left behind."
  (let ((maxima::$errormsg nil) (maxima::$error maxima::$error))
    (let ((answer (maxima::errcatch
                    (handler-case (call-interruptibly (lambda () (maxima::meval (second form))))
                      (storage-condition () (maxima::merror "the recursion does not end"))))))
      (if answer (first answer) (maxima::$anmech_not_found 'maxima::$failed)))))

(maxima::defmspec maxima::$anmech_silently (form)
  "anmech_silently(expr): the value of expr; what the libraries behind Maxima print on the way is lost."
  (let ((*standard-output* (make-broadcast-stream)))
    (maxima::meval (second form))))
