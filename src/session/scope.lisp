;;; anmech: the local variables of modules have names of their own.
;;;
;;; Maxima scopes dynamically: a user's L, n or i would meet ours, and ours each other.  So every local variable is
;;; renamed to a symbol that belongs to its function alone and that no user can have typed.
;;;
;;; Entry points: RENAMINGS, RENAME-LOCALS, BOUND-VARIABLES, WITH-DECIDED-PREDICATES, *PLAIN-OPTIONS*, OPERATOR-P.

(in-package :anmech)

(defun operator-p (form operator)
  (and (consp form) (consp (car form)) (eq (caar form) operator)))

;;; Maxima's options

(defparameter *plain-options*
  '((maxima::$inflag nil) (maxima::$partswitch nil) (maxima::$float nil) (maxima::$numer nil) (maxima::$keepfloat nil)
    (maxima::$ratprint nil) (maxima::$ratfac nil) (maxima::$algebraic nil) (maxima::$listarith t)
    (maxima::$prederror nil) (maxima::$expop 0) (maxima::$expon 0) (maxima::$exponentialize nil)
    (maxima::$demoivre nil) (maxima::$halfangles nil) (maxima::$trigexpand nil) (maxima::$logarc nil)
    (maxima::$logexpand t) (maxima::$radexpand t) (maxima::$exptsubst nil) (maxima::$derivsubst nil)
    (maxima::$opsubst t) (maxima::$sumexpand nil) (maxima::$simpsum nil) (maxima::$factorflag nil)
    (maxima::$globalsolve nil) (maxima::$programmode t) (maxima::$backsubst t) (maxima::$linsolve_params t)
    (maxima::$linsolvewarn nil) (maxima::$solveradcan nil) (maxima::$solveexplicit nil) (maxima::$solvetrigwarn nil)
    (maxima::$negdistrib t) (maxima::$distribute_over t) (maxima::$domain maxima::$real)
    (maxima::$m1pbranch nil) (maxima::$letrat nil) (maxima::$stardisp nil) (maxima::$refcheck nil)
    (maxima::$ratsimpexpons nil) (maxima::$ratdenomdivide t) (maxima::$ratexpand nil) (maxima::$piece nil)
    (maxima::$doallmxops t) (maxima::$domxmxops t) (maxima::$domxplus nil) (maxima::$doscmxops nil)
    (maxima::$doscmxplus nil) (maxima::$sparse nil) (maxima::$ratmx nil) (maxima::$detout nil)
    (maxima::modulus nil) (maxima::$mx0simp t) (maxima::$matrix_element_transpose nil)
    (maxima::$matrix_element_mult "*")
    (maxima::$matrix_element_add "+") (maxima::$scalarmatrixp t) (maxima::$assumescalar t) (maxima::$simp t)
    (maxima::$errexp1 nil) (maxima::$errexp2 nil) (maxima::$exptdispflag t) (maxima::$logabs nil)
    (maxima::$ratwtlvl nil) (maxima::$realonly nil) (maxima::$trigexpandtimes t) (maxima::$gcd maxima::$spmod)
    (maxima::$maxmin_effort 10) (maxima::$maxposex 1000) (maxima::$maxnegex 1000)
    (maxima::$listconstvars nil) (maxima::$infeval nil)
    (maxima::$ratvars ((maxima::mlist maxima::simp))) (maxima::varlist nil) (maxima::genvar nil))
  "Maxima's options at their defaults: what the user has set must not change what we compute.")

;;; Local variables get names of their own

(defun binder-variables (form)
  "The variables that FORM itself binds."
  (flet ((names (list)
           (loop for item in list
                 append (cond ((symbolp item) (list item))
                              ((operator-p item 'maxima::msetq) (list (second item)))
                              ((operator-p item 'maxima::mlist) (rest item))
                              ((operator-p item 'maxima::mquote) (rest item))))))
    (case (caar form)
      ((maxima::mprog maxima::lambda)
       (and (operator-p (second form) 'maxima::mlist) (names (rest (second form)))))
      ((maxima::mdo maxima::mdoin) (names (list (second form))))
      ((maxima::$makelist maxima::$sum maxima::$product maxima::%sum maxima::%product)
       (and (symbolp (third form)) (names (list (third form)))))
      (maxima::$create_list (names (remove-if-not #'symbolp (cddr form)))))))

(defun bound-variables (form)
  "Every variable that FORM or a part of it binds."
  (and (consp form)
       (append (and (consp (car form)) (binder-variables form))
               (loop for part in form append (bound-variables part)))))

(defun renamings (variables function)
  "Private names of the VARIABLES of FUNCTION, which no other function shares: so a lambda handed to a helper sees the
variables of the function that it stands in.  An option of Maxima's is bound under its own name, for it is Maxima that
reads it."
  (loop for variable in (remove-duplicates (remove nil variables))
        unless (assoc variable *plain-options*)
        collect (cons variable (intern (concatenate 'string (symbol-name variable) "`" (symbol-name function))
                                                :maxima))))

(defun rename-locals (form renamed)
  "FORM with its local variables renamed, except where a symbol stands for itself: quoted ('name), as the name of a
field (sys@name) or of an option (verb(sys, name = ..))."
  (labels ((walk (form)
             (cond ((symbolp form) (let ((pair (assoc form renamed))) (if pair (cdr pair) form)))
                   ((atom form) form)
                   ((and (operator-p form 'maxima::mquote) (symbolp (second form))) form)
                   ((operator-p form 'maxima::$@) (list (first form) (walk (second form)) (third form)))
                   ((and (consp (car form)) (get (caar form) 'module))
                    (cons (first form) (mapcar #'walk-argument (rest form))))
                   ((consp (car form)) (cons (cons (walk (caar form)) (cdar form)) (mapcar #'walk (rest form))))
                   (t (mapcar #'walk form))))
           (walk-argument (argument)
             (if (operator-p argument 'maxima::mequal)
                 (list (first argument) (second argument) (walk (third argument)))
                 (walk argument))))
    (walk form)))

;;; Predicates.  Maxima's sublist, every ... evaluate what a predicate has returned: an equation between the user's
;;; variables would be asked of their values.  So  lambda([e], lhs(e) = x)  in such a place decides there.

(defun with-decided-predicates (form)
  (labels ((walk (form)
             (cond ((atom form) form)
                   ((and (consp (car form))
                         (member (caar form) '(maxima::$sublist maxima::$sublist_indices maxima::$every maxima::$some
                                               maxima::$subset)))
                    (cons (car form) (mapcar (lambda (part) (decided (walk part))) (rest form))))
                   (t (cons (walk (car form)) (walk (cdr form))))))
           (decided (form)
             (if (and (operator-p form 'maxima::lambda) (predicate-form-p (first (last form))))
                 (append (butlast form) `(((maxima::$is) ,(first (last form)))))
                 form)))
    (walk form)))

(defun predicate-form-p (form)
  (and (consp form) (consp (car form))
       (member (caar form) '(maxima::mequal maxima::mnotequal maxima::mgreaterp maxima::mlessp maxima::mgeqp
                             maxima::mleqp maxima::mand maxima::mor maxima::mnot))))
