;;;; evaluations.lisp: what rtest_prepared_code.mac asks.
;;;;
;;;;   evaluations(f(x, ..) := body, a, ..)
;;;;        f(a, ..) as a function of a module, prepared, and as Maxima's evaluator does it: the value, or the text of
;;;;        the error; and the values that the local variables still have, of which there should be none.  One such list
;;;;        if both are alike, else both of them
;;;;   fundef_or_none(f)
;;;;        the definition of a function of the user's

(in-package :anmech-tests)

(maxima::defmspec maxima::$evaluations (form)
  (destructuring-bind (statement . arguments) (rest form)
    (let ((name (caar (second statement))) (arguments (mapcar #'maxima::meval arguments)))
      (unwind-protect
           (let ((anmech::*module* "a test"))
             (anmech::load-statement statement)
             (let* ((definition (get name 'anmech::definition))
                    (prepared (outcome definition (lambda () (anmech::call-definition definition arguments))))
                    (plain (outcome definition
                                    (lambda ()
                                      (maxima::mlambda (anmech::definition-lambda definition) arguments name t nil)))))
               (if (maxima::alike1 prepared plain) prepared (list '(maxima::mlist) prepared plain))))
        (remprop name 'anmech::definition)
        (fmakunbound name)))))

(defun outcome (definition thunk)
  (let ((maxima::$errormsg nil) (maxima::dsksetp t) (maxima::$values (copy-list maxima::$values)))
    (append (list '(maxima::mlist)
                  (handler-case (anmech::with-maxima-errors (funcall thunk))
                    (maxima::maxima-$error () (anmech::text-of-error))))
            (values-left (anmech::definition-lambda definition)))))

(defun values-left (form)
  (loop for symbol in (remove-duplicates (private-symbols form))
        when (boundp symbol)
          collect (list '(maxima::mequal) symbol (symbol-value symbol))))

(defun private-symbols (form)
  (cond ((consp form) (append (private-symbols (car form)) (private-symbols (cdr form))))
        ((anmech::private-p form) (list form))))

(defun maxima::$of_lisp (argument)
  (declare (ignore argument))
  "from Lisp")

(maxima::defmspec maxima::$fundef_or_none (form)
  (or (maxima::mget (second form) 'maxima::mexpr) 'maxima::$none))
