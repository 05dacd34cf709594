;;; anmech: what the functions of modules do, prepared for being done many times.
;;;
;;; Maxima evaluates a formula by looking up, each time, what its operator is; it binds a local variable by a dozen
;;; checks of what the name may be to a user.  The body of a module's function is looked at once instead, at its first
;;; call, and becomes a closure that does what meval would: the same values, without the looking up.  Local variables
;;; have names that nobody else has (scope.lisp), and so need no checks.  What is not known here is left to meval, with
;;; its arguments prepared where it evaluates all of them.  One thing differs: a return of a user's function that stands
;;; in no block and no loop, which alone is an error, leaves in Maxima the block that happened to call it; here it is
;;; an error, or leaves one further out.
;;;
;;; (Maxima's translator makes Lisp code that must be compiled, which is slow or impossible here and there, and whose
;;; meaning differs in corners; with debugmode(true) Maxima itself evaluates everything.)
;;;
;;; Entry points: PREPARED, EVALUATE, EVALUATE-ALL, CALL-WITH-VALUES; DEFINE-PREPARATION, DEFINE-HANDED-ON, HANDED-ON,
;;; LEFT-TO-MAXIMA, SIMPLIFIED, CALLS-P, *KINDS-OF-CALLS*; for tests PRIVATE-P.

(in-package :anmech)
(needs "session/scope")

(deftype thunk () 'function)

(declaim (inline simplified evaluate))
(defun simplified (form)
  "FORM as meval hands it out."
  (if (atom form) form (maxima::simplifya form nil)))

(defun evaluate (thunk) (funcall (the thunk thunk)))

(defun evaluate-all (thunks) (loop for thunk in thunks collect (evaluate thunk)))

(defun private-p (form)
  "Whether FORM is a local variable of a module's function."
  (and (symbolp form) (find #\` (symbol-name form)) t))

;;; Local variables

(defun set-all (variables values)
  (loop for variable in variables for value in values do (set variable value)))

(defun call-with-values (variables values thunk)
  "Call THUNK while the private VARIABLES have VALUES."
  (let ((before (loop for variable in variables
                      collect (if (boundp variable) (symbol-value variable) 'none))))
    (unwind-protect (progn (set-all variables values) (evaluate thunk))
      (loop for variable in variables
            for value in before
            do (if (eq value 'none) (makunbound variable) (set variable value))))))

;;; Preparing

(defmacro define-preparation (operator (form) &body body)
  "BODY makes a closure of FORM, whose operator is OPERATOR; or nil, where Maxima itself shall evaluate it."
  (let ((name (intern (format nil "~a-PREPARATION" operator) :anmech)))
    `(progn (defun ,name (,form) ,@body)
            (setf (get ',operator 'preparation) ',name))))

(defun prepared (form)
  "A closure that returns what (meval FORM) would."
  (cond ((private-p form) (lambda () (if (boundp form) (simplified (symbol-value form)) form)))
        ((member form '(nil maxima::$false)) (lambda () nil))
        ((member form '(t maxima::$true)) (lambda () t))
        ((and (atom form) (not (symbolp form))) (lambda () form))
        ((subscripted-p form) (prepared-subscript form))
        ((has-plain-operator-p form)
         (let ((preparation (get (caar form) 'preparation)))
           (or (and preparation (funcall preparation form))
               (and (not preparation) (prepared-call form))
               (lambda () (maxima::meval form)))))
        (t (lambda () (maxima::meval form)))))

(defun has-plain-operator-p (form)
  "Its operator may carry the line that it was read from."
  (and (consp form) (consp (car form)) (symbolp (caar form))
       (not (member 'maxima::array (cdar form)))
       (or (not (member 'maxima::simp (cdar form))) (eq (caar form) 'maxima::mquote))))

(setf (get 'prepared 'maxima::mfexpr*) 'evaluate-prepared
      (get 'prepared 'maxima::formatter) 'formatted-original)

(defun formatted-original (form) (maxima::nformat (second form)))

(defun evaluate-prepared (form)
  "FORM is ((prepared (original . thunk)) form).  What has been put into the form since, by subst for example, the thunk
does not know."
  (let ((own (second (first form))))
    (if (and (consp own) (eq (car own) (second form)))
        (evaluate (cdr own))
        (maxima::meval (second form)))))

(defun handed-on (form)
  "FORM for Maxima's evaluator, prepared.  What looks into it, or shows it, sees FORM."
  (if (atom form) form `((prepared (,form . ,(prepared form))) ,form)))

(defun value-handed-on (value)
  "VALUE for Maxima's evaluator, that shall not evaluate it again."
  `((prepared (,value . ,(lambda () value))) ,value))

(defun with-arguments-prepared (form)
  (cons (first form) (mapcar #'handed-on (rest form))))

(defun left-to-maxima (form)
  (lambda () (maxima::meval form)))

;;; Calls

(defun prepared-call (form)
  "What a function is may be known at the first call only."
  (let ((call nil))
    (lambda () (evaluate (or call (setq call (call-of-its-kind form)))))))

(defvar *kinds-of-calls* '()
  "Functions that make a closure of a call that they know, of a module's function for example, or return nil.")

(declaim (inline defined-by-user-p))
(defun defined-by-user-p (name)
  "Whether Maxima would call something else than the Lisp function NAME: a user may define it, or trace it, any time."
  (and (get name 'maxima::mprops)
       (maxima::mgetl name '(maxima::mexpr maxima::mmacro maxima::trace))))

(defun call-of-its-kind (form)
  (let ((head (caar form)))
    (cond ((some (lambda (kind) (funcall kind form)) *kinds-of-calls*))
          ((plain-function-p head) (call-of-plain-function form))
          ((get head 'maxima::mfexpr*) (left-to-maxima form))
          ((private-p head) (call-by-maxima form (lambda () (and (boundp head) (symbol-value head)))))
          (t (call-by-maxima form (lambda () head))))))

(defun call-of-plain-function (form)
  (let ((head (caar form)) (arguments (mapcar #'prepared (rest form))))
    (lambda ()
      (if (defined-by-user-p head)
          (maxima::meval form)
          (simplified (apply head (evaluate-all arguments)))))))

(defun call-by-maxima (form function)
  "FUNCTION is a thunk that returns what is called."
  (let ((prepared (with-arguments-prepared form)))
    (lambda () (maxima::meval (if (takes-forms-p (evaluate function)) form prepared)))))

(define-preparation maxima::mqapply (form)
  (destructuring-bind (function . arguments) (rest form)
    (unless (operator-p function 'maxima::mquote)
      (let ((function (prepared function)) (prepared (mapcar #'handed-on arguments)))
        (lambda ()
          (let ((function (evaluate function)))
            (maxima::meval (list* (first form)
                                  (if (operator-p function 'maxima::lambda) function (value-handed-on function))
                                  (if (takes-forms-p function) arguments prepared)))))))))

(defun takes-forms-p (function)
  "Whether FUNCTION, a symbol, a string or a lambda expression, is given its arguments, or one of them, as they are
written."
  (let ((name (maxima::getopr function)))
    (flet ((quotes-p (definition) (and (operator-p definition 'maxima::lambda)
                                       (calls-p (second definition) 'maxima::mquote))))
      (if (symbolp name)
          (and name
               (or (get name 'maxima::mfexpr*)
                   (get name 'maxima::translated-mmacro)
                   (maxima::mgetl name '(maxima::mmacro))
                   (quotes-p (maxima::mget name 'maxima::mexpr))))
          (quotes-p name)))))

(defun plain-function-p (name)
  "Whether Maxima would call the Lisp function NAME, with all its arguments evaluated."
  (and (fboundp name)
       (not (macro-function name))
       (not (special-operator-p name))
       (not (get name 'maxima::mfexpr*))
       (not (get name 'maxima::translated-mmacro))
       (not (defined-by-user-p name))))

;;; Formulas

(macrolet ((define-formulas (&rest operators)
             `(progn ,@(loop for operator in operators
                             collect `(define-preparation ,operator (form) (prepared-formula form))))))
  (define-formulas maxima::mplus maxima::mtimes maxima::mexpt maxima::mlist maxima::mequal maxima::mnotequal
                   maxima::mgreaterp maxima::mlessp maxima::mgeqp maxima::mleqp maxima::mminus maxima::mquotient))

(defun prepared-formula (form)
  (if (eq (second form) 'maxima::$%e)
      (left-to-maxima (with-arguments-prepared form))             ; numer leaves %e alone as the base of a power only
      (let ((head (list (caar form))) (arguments (mapcar #'prepared (rest form))))
        (lambda () (maxima::simplifya (cons head (evaluate-all arguments)) nil)))))

(define-preparation maxima::mquote (form)
  (let ((value (second form)))
    (lambda () (simplified value))))

;;; Parts of lists and matrices

(defun subscripted-p (form)
  (and (consp form) (consp (car form)) (member 'maxima::array (cdar form))
       (or (private-p (caar form)) (eq (caar form) 'maxima::mqapply))))

(defun prepared-subscript (form)
  (destructuring-bind (whole . places) (if (private-p (caar form)) (cons (caar form) (rest form)) (rest form))
    (let ((whole-thunk (prepared whole)) (place-thunks (mapcar #'prepared places)))
      (lambda ()
        (let ((whole (evaluate whole-thunk)))
          (if (or (operator-p whole 'maxima::mlist) (operator-p whole 'maxima::$matrix))
              (let ((places (evaluate-all place-thunks)))
                (multiple-value-bind (part found-p) (part-at whole places)
                  (if found-p
                      (simplified part)
                      (part-by-maxima form whole (mapcar #'value-handed-on places)))))
              (part-by-maxima form whole (mapcar #'handed-on places))))))))

(defun part-by-maxima (form whole places)
  "The value of FORM, of which WHOLE is the value of what it takes a part of.  An error names the variable."
  (let ((variable (caar form)))
    (cond ((not (private-p variable)) (maxima::meval (list* (first form) (value-handed-on whole) places)))
          ((and (boundp variable) (eq (symbol-value variable) whole)) (maxima::meval (cons (first form) places)))
          (t (call-with-values (list variable) (list whole)
                               (lambda () (maxima::meval (cons (first form) places))))))))

(defun part-at (whole places)
  "The part of WHOLE, a list or a matrix, and t; or nil and nil."
  (when (or (null (rest places)) (and (operator-p whole 'maxima::$matrix) (null (cddr places))))
    (dolist (place places (values whole t))
      (unless (and (typep place '(and fixnum (integer 1)))
                   (or (operator-p whole 'maxima::mlist) (operator-p whole 'maxima::$matrix))
                   (nthcdr place whole))
        (return (values nil nil)))
      (setq whole (nth place whole)))))

;;; Statements

(defun in-turn (thunks)
  (if (rest thunks)
      (lambda () (let ((value nil)) (dolist (thunk thunks value) (setq value (evaluate thunk)))))
      (first thunks)))

(define-preparation maxima::mprogn (form)
  (and (rest form) (in-turn (mapcar #'prepared (rest form)))))

(define-preparation maxima::msetq (form)
  (destructuring-bind (target value-form) (rest form)
    (let ((value (prepared value-form)))
      (cond ((private-p target) (lambda () (set target (evaluate value))))
            ((and (operator-p target 'maxima::mlist) (every #'private-p (rest target)))
             (let ((variables (rest target)) (most (length (rest target))))
               (lambda ()
                 (let ((found (evaluate value)))
                   (cond ((and (operator-p found 'maxima::mlist) (= (length (rest found)) most))
                          (set-all variables (rest found))
                          found)
                         (t (maxima::mset target found)))))))
            (t (left-to-maxima (list (first form) target (handed-on value-form))))))))

(define-preparation maxima::mprog (form)
  (multiple-value-bind (declared statements)
      (if (operator-p (second form) 'maxima::mlist)
          (values (rest (second form)) (cddr form))
          (values '() (rest form)))
    (let* ((variables (mapcar (lambda (item) (if (atom item) item (second item))) declared))
           (initial (mapcar (lambda (item) (if (atom item) (lambda () item) (prepared (third item)))) declared))
           (body (and statements (every #'private-p variables) (notany #'symbolp (butlast statements))
                      (equal variables (remove-duplicates variables))
                      (not (calls-p statements 'maxima::$local))
                      (in-turn (mapcar #'prepared statements)))))
      (when (and body (calls-p statements 'maxima::mreturn)) (setq body (with-return body)))
      (and body (lambda () (call-with-values variables (evaluate-all initial) body))))))

(defun calls-p (form operator)
  "Whether OPERATOR stands anywhere in FORM, or in a list of forms."
  (and (consp form)
       (or (eq (car form) operator)
           (loop for part in form thereis (calls-p part operator)))))

(defun with-return (body)
  (lambda ()
    (let* ((maxima::mprogp t)
           (whole nil)
           (value (catch 'maxima::mprog (prog1 (evaluate body) (setq whole t)))))
      (cond (whole value)
            ((consp value) (first value))
            (t (maxima::merror "block: no such tag: ~:M" value))))))

(define-preparation maxima::mcond (form)
  (let ((branches (loop for (test value) on (rest form) by #'cddr
                        collect (list (prepared-test test) (prepared value)))))
    (lambda ()
      (loop for ((test value) . nil) on branches
            for rest on (cddr form) by #'cddr
            for decision = (evaluate test)
            do (cond ((eq decision t) (return (evaluate value)))
                     (decision (return (left-open (first form) decision rest))))))))

(defun left-open (head decision rest)
  "What Maxima makes of a condition that it cannot decide; DECISION is not evaluated again."
  (let ((open (maxima::meval1 (list* head 'left-open rest))))
    (simplified (list* (first open) decision (cddr open)))))

;;; Conditions

(defun prepared-test (form)
  "A closure that returns what (mevalp FORM) would: t, nil, or what cannot be decided."
  (let ((parts (and (has-plain-operator-p form) (rest form))))
    (case (and parts (caar form))
      (maxima::mnot (negation (prepared-test (first parts))))
      (maxima::mand (conjunction (mapcar #'prepared-test parts)))
      (maxima::mor (disjunction (mapcar #'prepared-test parts)))
      (maxima::mequal (comparison parts #'maxima::like))
      (maxima::mnotequal (comparison parts (lambda (a b) (not (maxima::like a b)))))
      ((maxima::mgreaterp maxima::mlessp maxima::mgeqp maxima::mleqp) (order-relation (caar form) parts))
      (t (let ((value (prepared form)))
           (lambda () (decided (evaluate value))))))))

(defun decided (value)
  (if (or (null value) (eq value t)) value (maxima::mevalp `((maxima::mquote) ,value))))

(defun negation (test)
  (lambda ()
    (let ((value (evaluate test)))
      (cond ((eq value t) nil)
            ((null value) t)
            (t (maxima::pred-reverse value))))))

(defun conjunction (tests)
  (lambda ()
    (let ((open '()))
      (dolist (test tests (undecided-part 'maxima::mand open t))
        (let ((value (evaluate test)))
          (cond ((null value) (return nil))
                ((not (eq value t)) (push value open))))))))

(defun disjunction (tests)
  (lambda ()
    (let ((open '()))
      (dolist (test tests (undecided-part 'maxima::mor open nil))
        (let ((value (evaluate test)))
          (cond ((eq value t) (return t))
                (value (push value open))))))))

(defun undecided-part (operator open otherwise)
  "What of the parts of a condition cannot be decided, the last first."
  (cond ((null open) otherwise)
        ((null (rest open)) (first open))
        (t (cons (list operator) (reverse open)))))

(defun comparison (parts function)
  (destructuring-bind (a b) (mapcar #'prepared parts)
    (lambda () (funcall (the function function) (evaluate a) (evaluate b)))))

(defun order-relation (operator parts)
  (let ((compare (ecase operator
                   (maxima::mgreaterp #'>) (maxima::mlessp #'<) (maxima::mgeqp #'>=) (maxima::mleqp #'<=))))
    (destructuring-bind (a b) (mapcar #'prepared parts)
      (lambda ()
        (let ((left (evaluate a)) (right (evaluate b)))
          (if (or (and (integerp left) (integerp right))
                  (and (typep left 'double-float) (typep right 'double-float)))
              (funcall (the function compare) left right)
              (maxima::mevalp (list (list operator) (list '(maxima::mquote) left) (list '(maxima::mquote) right)))))))))

(macrolet ((define-conditions (&rest operators)
             `(progn ,@(loop for operator in operators
                             collect `(define-preparation ,operator (form)
                                        (let ((test (prepared-test form)))
                                          (lambda () (simplified (evaluate test)))))))))
  (define-conditions maxima::mand maxima::mor maxima::mnot))

(define-preparation maxima::$is (form)
  (and (= (length form) 2)
       (let ((test (prepared-test (second form))))
         (lambda ()
           (let ((value (evaluate test)))
             (if (or (null value) (eq value t)) value 'maxima::$unknown))))))

;;; What binds variables by itself

(define-preparation maxima::lambda (form)
  (and (not (calls-p form 'maxima::$local))
       (let ((value nil))
         (lambda ()
           (or value
               (setq value (maxima::meval (list* (first form) (second form) (mapcar #'handed-on (cddr form))))))))))

(define-preparation maxima::mdo (form)
  (destructuring-bind (variable first step next limit end body) (rest form)
    (let ((counter (or variable 'maxima::|counter`|)))
      (if (or next (not (private-p counter)) (not (typep step '(or null (integer 1))))
              (calls-p (list limit end) 'maxima::mreturn))
          (left-to-maxima (with-variable-kept form))
          (prepared-loop counter (if first (prepared first) (lambda () 1))
                         `((maxima::mor) ,@(and limit `(((maxima::mgreaterp) ,counter ,limit))) ,end)
                         body
                         (prepared `((maxima::mplus) ,(or step 1) ,counter)))))))

(defun with-variable-kept (form)
  (list* (first form) (second form) (mapcar #'handed-on (cddr form))))

(defun prepared-loop (variable first end body next)
  (let* ((ended (prepared-test end))
         (work (prepared body))
         (run (lambda ()
                (loop until (certainly ended)
                      do (evaluate work)
                         (set variable (evaluate next)))
                'maxima::$done)))
    (when (calls-p body 'maxima::mreturn) (setq run (with-return run)))
    (lambda () (call-with-values (list variable) (list (evaluate first)) run))))

(defun certainly (test)
  "The value of TEST; an error if it cannot be decided."
  (let ((maxima::$prederror t)) (evaluate test)))

(define-preparation maxima::mdoin (form)
  (destructuring-bind (variable set nil nil limit end body) (rest form)
    (if (or limit (not (private-p variable)) (calls-p end 'maxima::mreturn))
        (left-to-maxima (with-variable-kept form))
        (let ((items (prepared set)) (ended (prepared-test end)) (work (prepared body)))
          (flet ((run (list)
                   (lambda ()
                     (loop for (nil . more) on list
                           until (certainly ended)
                           do (evaluate work)
                              (when more (set variable (first more))))
                     'maxima::$done)))
            (lambda ()
              (let ((list (evaluate items)))
                (cond ((not (operator-p list 'maxima::mlist))
                       (maxima::meval (list* (first form) variable `((maxima::mquote) ,list) (cdddr form))))
                      ((null (rest list)) 'maxima::$done)
                      (t (let ((run (run (rest list))))
                           (call-with-values (list variable) (list (second list))
                                             (if (calls-p body 'maxima::mreturn) (with-return run) run))))))))))))

(define-preparation maxima::$makelist (form)
  (destructuring-bind (&optional body variable . range) (rest form)
    (and (private-p variable)
         (<= 1 (length range) 2)
         (let ((value (prepared body)) (bounds (mapcar #'prepared range)))
           (lambda ()
             (let* ((bounds (evaluate-all bounds)) (places (places-of bounds)))
               (if (eq places 'unknown)
                   (maxima::meval (list* (first form) body variable
                                         (mapcar (lambda (bound) (list '(maxima::mquote) bound)) bounds)))
                   (listed variable places value))))))))

(defun places-of (bounds)
  "What the variable of makelist runs through."
  (destructuring-bind (first &optional last) bounds
    (cond ((and (integerp first) (integerp last)) (loop for place from first to last collect place))
          ((and (not last) (operator-p first 'maxima::mlist)) (rest first))
          (t 'unknown))))

(defun listed (variable places value)
  (simplified
   (cons '(maxima::mlist)
         (let ((found '()))
           (call-with-values (list variable) '()
                             (lambda () (dolist (place places) (set variable place) (push (evaluate value) found))))
           (nreverse found)))))

;;; What evaluates its arguments, or one of them when it is its time

(defmacro define-handed-on (&rest operators)
  "OPERATORS are of special forms that do nothing with a part that they are given but evaluate it, if that."
  `(progn ,@(loop for operator in operators
                  collect `(define-preparation ,operator (form) (left-to-maxima (with-arguments-prepared form))))))

(define-handed-on maxima::$map maxima::$maplist maxima::$matrixmap maxima::$create_list)
