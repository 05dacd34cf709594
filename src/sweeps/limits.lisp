;;; anmech: calls of functions that others have given, with a limit of time; and the guard of a verb for a worker, which
;;; no verb has called.
;;;
;;; Entry points: anmech_dependencies_in, anmech_are_dependencies, anmech_limited, anmech_given_up, anmech_not_begun,
;;; anmech_as_verb, anmech_with_own_values, anmech_assigned_elsewhere, anmech_text_checksum, anmech_new_line.

(in-package :anmech)
(needs "session/guard" "session/patience" "session/scope" "session/structures" "session/texts" "algebra/terms"
       "arithmetic/checksums" "numerics/motions")

(defun result-of-map (value status)
  (maxima-list (list 0d0 nil status (maxima-list (list (maxima-list (list value)))))))

(maxima::defmfun maxima::$anmech_given_up (seconds)
  "anmech_given_up(seconds): what a map keeps of a case that took longer."
  (result-of-map 'maxima::$unknown (format nil "given up after ~a seconds" (maxima-text seconds))))

(maxima::defmfun maxima::$anmech_not_begun (error)
  "anmech_not_begun(error): what is kept of a point that an interruption came before, with its estimate of the error:
unknown, or false where there is none."
  (maxima-list (list 'maxima::$unknown error *not-begun* (maxima-list '()))))

(defun with-polling-loops (form)
  "FORM, of Maxima, whose loops ask at every turn whether there is time left."
  (cond ((or (atom form) (operator-p form 'maxima::mquote)) form)
        ((and (or (operator-p form 'maxima::mdo) (operator-p form 'maxima::mdoin)) (= (length form) 8))
         (append (mapcar #'with-polling-loops (butlast form))
                 `(((maxima::mprogn) ((maxima::$anmech_poll)) ,(with-polling-loops (first (last form)))))))
        (t (mapcar #'with-polling-loops form))))

(maxima::defmfun maxima::$anmech_poll () "anmech_poll(): gives up what takes too long." (poll))

;;; What names were declared to depend on: a derivative that such a function takes is 0 where nothing is known of that.

(maxima::defmfun maxima::$anmech_dependencies_in (form)
  "anmech_dependencies_in(expr): a list [x, t, ...] for each name in it that was declared to depend on t, ..."
  (let ((names '()))
    (labels ((walk (form)
               (cond ((consp form) (walk (car form)) (walk (cdr form)))       ; q of q[1] is an operator
                     ((and form (symbolp form)
                           (eql 0 (position #\$ (symbol-name form)))
                           (consp (maxima::mget form 'maxima::depends)))
                      (pushnew form names)))))
      (walk form))
    (maxima-list (loop for name in (sort names #'string< :key #'symbol-name)
                       for others = (maxima::mget name 'maxima::depends)
                       when (every #'symbolp others) collect (maxima-list (cons name others))))))

(maxima::defmfun maxima::$anmech_are_dependencies (list)
  "anmech_are_dependencies(list): whether it is one as anmech_dependencies_in gives."
  (flet ((name-p (form) (and form (symbolp form) (eql 0 (position #\$ (symbol-name form))))))
    (and (operator-p list 'maxima::mlist)
         (every (lambda (names) (and (operator-p names 'maxima::mlist) (cddr names) (every #'name-p (rest names))))
                (rest list)))))

(defun with-dependencies (list thunk)
  "The value of THUNK while names depend on others as LIST has it, those of which nothing else has been declared."
  (let ((new (remove-if (lambda (names) (maxima::mget (second names) 'maxima::depends)) (rest list))))
    (unwind-protect
         (progn (dolist (names new)
                  (maxima::meval `((maxima::$depends) ,(second names) ,(maxima-list (cddr names)))))
                (funcall thunk))
      (dolist (names new) (maxima::meval `((maxima::$remove) ,(second names) maxima::$dependency))))))

(maxima::defmfun maxima::$anmech_limited (function argument seconds dependencies)
  "anmech_limited(f, x, seconds, dependencies): what a map keeps of f(x), [0.0, false, status, [[value]]]: of an error
its sentence; while names depend on others as a list of anmech_dependencies_in has it."
  (handler-case
      (let ((value (call-within (maxima::mfuncall 'maxima::$float seconds)
                                (lambda ()
                                  (with-dependencies dependencies
                                    (lambda ()
                                      (maxima::$anmech_call (with-polling-loops function) argument)))))))
        (when (eq value :interrupted) (setq *interruption* :told))
        (cond ((eq value :late) (maxima::$anmech_given_up seconds))
              (*interruption* (result-of-map 'maxima::$unknown "interrupted"))  ; or what it has is not all
              (t (result-of-map value 'maxima::$complete))))
    (maxima::maxima-$error () (result-of-map 'maxima::$unknown (text-of-error)))
    (storage-condition () (result-of-map 'maxima::$unknown "a recursion of Maxima does not end"))))

(maxima::defmfun maxima::$anmech_as_verb (verb function &rest arguments)
  "anmech_as_verb('verb, 'f, ...): the value of f(...), called as that verb calls it."
  (with-guard verb (lambda () (maxima::mapply1 function arguments function nil))))

(maxima::defmfun maxima::$anmech_assigned_elsewhere (lambda)
  "anmech_assigned_elsewhere(lambda([x], ...)): a variable that it assigns and that is not its own; false: none."
  (let ((own (bound-variables lambda)))
    (labels ((assigned (place)
               (cond ((symbolp place) (and (not (member place own)) place))
                     ((operator-p place 'maxima::mlist) (some #'assigned (rest place)))
                     ((and (consp place) (consp (car place))) (assigned (caar place)))))
             (walk (form)
               (and (consp form)
                    (or (and (operator-p form 'maxima::msetq) (assigned (second form)))
                        (some #'walk (rest form))))))
      (walk lambda))))

(maxima::defmfun maxima::$anmech_with_own_values (lambda)
  "anmech_with_own_values(lambda([x], ...)): the same with the values of the user's variables put in, and of derivatives
like diff(q, t), which depend on what the user has declared."
  (let ((own (bound-variables lambda)))
    (labels ((walk (form)
               (cond ((and form (symbolp form) (boundp form) (not (constantp form)) (not (member form own))
                           (char= (char (symbol-name form) 0) #\$)
                           (not (gethash form maxima::*variable-initial-values*)))
                      `((maxima::mquote maxima::simp) ,(symbol-value form)))
                     ((atom form) form)
                     ((and (operator-p form 'maxima::$diff) (null (intersection (symbols-in form) own)))
                      `((maxima::mquote maxima::simp) ,(maxima::meval form)))
                     ((operator-p form 'maxima::mquote) form)
                     ((operator-p form 'maxima::mequal) (list (first form) (second form) (walk (third form))))
                     ((consp (car form)) (cons (car form) (mapcar #'walk (rest form))))
                     (t form))))
      (walk lambda))))

(maxima::defmfun maxima::$anmech_text_checksum (text)
  "anmech_text_checksum(text): CRC-32"
  (coerce (checksum-text (extended-checksum text)) 'simple-string))

(maxima::defmfun maxima::$anmech_new_line ()
  "anmech_new_line(): the text of it."
  (string #\Newline))
