;;; anmech: what has been derived from an object is remembered beside it; and what has passed a check.
;;;
;;; Entry points: anmech_remember, anmech_unless_passed; FORGET-UNDER-OTHER.

(in-package :anmech)
(needs "session/patience" "session/prepared_code")

;;; What has been derived from an object, remembered outside of it

(defvar *remembered* '() "List of (object . ((key . value) ...)), the latest first; objects are compared by identity.")
(defvar *facts* '() "The assumptions under which all this was derived.")
(defconstant +most-remembered+ 40)

(defun forget-under-other (facts)
  "What was derived under other assumptions than FACTS may be wrong now.  Returns FACTS: the very same list as long as
nothing else is assumed."
  (unless (equal facts *facts*)
    (setq *remembered* '() *facts* facts))
  *facts*)

(defun remembered (object key thunk)
  (let* ((entry (or (assoc object *remembered* :test #'eq)
                    (first (push (list object) *remembered*))))
         (pair (assoc key (rest entry) :test #'equal)))
    (when (> (length *remembered*) +most-remembered+)
      (setq *remembered* (subseq *remembered* 0 +most-remembered+)))
    (if pair
        (cdr pair)
        (let ((value (evaluate thunk)))
          (unless *interruption*               ; it may hold less than it should
            (push (cons key value) (rest entry)))
          value))))

(maxima::defmspec maxima::$anmech_remember (form)
  "anmech_remember(object, key, expr): the value of expr, evaluated once for this very object and key."
  (evaluate (prepared form)))

(define-preparation maxima::$anmech_remember (form)
  (destructuring-bind (object key value) (mapcar #'prepared (rest form))
    (lambda () (simplified (remembered (evaluate object) (evaluate key) value)))))

;;; Checks

(maxima::defmspec maxima::$anmech_unless_passed (form)
  "anmech_unless_passed(check(arguments)): check(arguments), for the errors that it may end with, unless these very
arguments have passed it the last time: what is called in a loop is checked once.  For checks that look at nothing
else."
  (evaluate (prepared form)))

(define-preparation maxima::$anmech_unless_passed (form)
  (let ((check (caar (second form))) (arguments (mapcar #'prepared (rest (second form)))))
    (lambda ()
      (let ((arguments (evaluate-all arguments)))
        (unless (equal arguments (get check 'passed))
          (maxima::mapply check arguments check)
          (setf (get check 'passed) arguments))
        'maxima::$done))))
