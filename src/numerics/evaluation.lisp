;;; Expressions evaluated without compiling: they are few, and evaluated some hundred times.
;;;
;;; Entry points: evaluated, numbers-list; $anmech_evaluate, $anmech_correct.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/dag" "numerics/doubles"
       "numerics/operations" "numerics/sharing")

(defun numbers-list (numbers)
  (cons '(maxima::mlist maxima::simp) (coerce numbers 'list)))

(defun apply-operation (operation a b)
  "The value of OPERATION, nil outside of its domain."
  (declare (double-float a b))
  (macrolet ((cases (&rest names)
               `(ecase operation
                  ,@(loop for name in names
                          collect `(,name (and ,(or (second (assoc name *domains*)) t)
                                               ,(operation-form name 'a 'b)))))))
    (cases :add :subtract :multiply :divide :negate :sqrt :sin :cos :tan :exp :log :expt :asin :acos :atan :atan2 :sinh
           :cosh :tanh :asinh :acosh :atanh :abs :signum :max :min)))

(defun run-program (program in)
  "The list of the results of PROGRAM for the inputs IN."
  (let* ((instructions (program-instructions program))
         (values (make-array (length instructions))))
    (flet ((value (operand)
             (cond ((integerp operand) (svref values operand))
                   ((eq :input (car operand)) (aref in (cdr operand)))
                   (t (cdr operand)))))
      (dotimes (index (length instructions))
        (destructuring-bind (operation a &optional b) (aref instructions index)
          (setf (svref values index)
                (or (apply-operation operation (value a) (if b (value b) 0d0))
                    (leave-domain (program-guards program) index)))))
      (mapcar #'value (program-results program)))))

(defun evaluated (expressions inputs arrays)
  "For each of ARRAYS, values of INPUTS, the list of the values of EXPRESSIONS."
  (let ((program (with-compilation-errors (lambda () (expressions-program expressions inputs)))))
    (handler-case (mapcar (lambda (in) (run-program program in)) arrays)
      (domain-violation (condition) (complain "~a" condition))
      (arithmetic-error () (complain "a value is too large for a double")))))

(defun exact-doubles (numbers)
  (doubles (mapcar (lambda (number) (to-double (exact-value number))) numbers)))

(maxima::defmfun maxima::$anmech_evaluate (expressions variables numbers)
  "anmech_evaluate([expr, ...], [variable, ...], [number, ...]): the list of the values, doubles."
  (numbers-list (first (evaluated (rest expressions) (rest variables) (list (exact-doubles (rest numbers)))))))

(maxima::defmfun maxima::$anmech_correct (equations inputs numbers variables)
  "anmech_correct(equations, inputs, numbers, variables): Newton's method.  EQUATIONS are the entries of A and b of
A u = b in the inputs; the first unknowns are the corrections of the variables, which are among the inputs.  The list
of all numbers, corrected; false if A is singular or the corrections do not fade."
  (let* ((size (isqrt (length (rest equations))))
         (in (exact-doubles (rest numbers)))
         (places (mapcar (lambda (variable) (position variable (rest inputs) :test #'equal)) (rest variables))))
    (loop repeat 50
          do (let* ((entries (doubles (first (evaluated (rest equations) (rest inputs) (list in)))))
                    (solution (subseq entries (* size size)))
                    (largest 0d0))
               (unless (solve-linear-in-place size entries solution) (return nil))
               (loop for place in places
                     for i from 0
                     do (let ((corrected (+ (aref in place) (aref solution i))))
                          (unless (= corrected (aref in place))
                            (setq largest (max largest (/ (abs (aref solution i))
                                                          (max (abs corrected) (abs (aref in place)))))))
                          (setf (aref in place) corrected)))
               (when (<= largest 1d-15) (return (numbers-list in))))
          finally (return nil))))
