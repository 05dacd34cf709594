;;; anmech: programs and expressions evaluated without compiling, with any numbers.
;;;
;;; In doubles they go through registers (registers.lisp): a compiled function takes long to make.
;;;
;;; Entry points: PROGRAM-FUNCTION, the structure NUMBER-TYPE; EXPRESSIONS-FUNCTION, EXPRESSIONS-REGISTERS,
;;; WITH-VALUE-ERRORS, EVALUATED, NUMBERS-LIST, EXACT-DOUBLES; $anmech_evaluate, $anmech_evaluator,
;;; $anmech_evaluated, $anmech_solved_by_numbers, $anmech_correct.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/dag" "numerics/doubles"
       "numerics/operations" "numerics/registers" "numerics/sharing")

(defun numbers-list (numbers)
  (cons '(maxima::mlist maxima::simp) (coerce numbers 'list)))

(defstruct number-type
  "What kind of numbers a program is run with.  NUMBER and CONSTANT are functions that give those of a rational and of a
name such as %pi; OPERATE, a function (operation a [b]), gives the value of an operation, nil outside of its domain."
  number constant operate)

(defun double-operation (operation a &optional (b 0d0))
  (declare (double-float a b))
  (macrolet ((cases (&rest names)
               `(ecase operation
                  ,@(loop for name in names
                          collect `(,name (and ,(or (second (assoc name *domains*)) t)
                                               ,(operation-form name 'a 'b)))))))
    (cases :add :subtract :multiply :divide :negate :sqrt :sin :cos :tan :exp :log :expt :asin :acos :atan :atan2 :sinh
           :cosh :tanh :asinh :acosh :atanh :erf :erfc :abs :signum :floor :max :min)))

(defvar *doubles*
  (make-number-type :number #'to-double
                    :constant (lambda (name) (to-double (cdr (assoc name *constants*))))
                    :operate #'double-operation))

(defun program-function (program &optional (type *doubles*))
  "What PROGRAM computes, with numbers of TYPE: a function of the vector of its inputs that gives the list of results."
  (labels ((known (operand)
             "OPERAND, or the list of the number that it stands for."
             (cond ((or (null operand) (integerp operand) (eq :input (car operand))) operand)
                   ((eq :number (car operand)) (list (funcall (number-type-number type) (cdr operand))))
                   (t (list (funcall (number-type-constant type) (cdr operand)))))))
    (let ((operate (number-type-operate type))
          (instructions (map 'vector
                             (lambda (instruction) (cons (first instruction) (mapcar #'known (rest instruction))))
                             (program-instructions program)))
          (results (mapcar #'known (program-results program))))
      (lambda (in) (run-instructions instructions results operate (program-guards program) in)))))

(defun run-instructions (instructions results operate guards in)
  (declare (type function operate) (simple-vector instructions))
  (let ((values (make-array (length instructions))))
    (flet ((value (operand)
             (cond ((integerp operand) (svref values operand))
                   ((eq :input (car operand)) (aref in (cdr operand)))
                   (t (car operand)))))
      (dotimes (index (length instructions))
        (destructuring-bind (operation a &optional b) (svref instructions index)
          (setf (svref values index)
                (or (if b (funcall operate operation (value a) (value b)) (funcall operate operation (value a)))
                    (leave-domain guards index)))))
      (mapcar #'value results))))

(defun expressions-function (expressions inputs)
  "A function of an array of doubles, the values of INPUTS: the list of those of EXPRESSIONS."
  (let ((registers (expressions-registers expressions inputs)) (count (length inputs)))
    (lambda (in)
      (replace (registers-numbers registers) (the double-array in) :end1 count)
      (run-registers registers)
      (result-list registers))))

(defun expressions-registers (expressions inputs)
  (with-compilation-errors (lambda () (registers-for (expressions-program expressions inputs) (length inputs)))))

(defun evaluated (expressions inputs arrays)
  "For each of ARRAYS, values of INPUTS, the list of the values of EXPRESSIONS."
  (let ((function (expressions-function expressions inputs)))
    (with-value-errors (lambda () (mapcar function arrays)))))

(defun with-value-errors (thunk)
  (handler-case (funcall thunk)
    (domain-violation (condition) (complain "~a" condition))
    (arithmetic-error () (complain "a value is too large for a double"))))

(defun exact-doubles (numbers)
  (doubles (mapcar (lambda (number) (to-double (exact-value number))) numbers)))

(maxima::defmfun maxima::$anmech_evaluator (expressions variables)
  "anmech_evaluator([expr, ...], [variable, ...]): what anmech_evaluated takes."
  (expressions-registers (rest expressions) (rest variables)))

(maxima::defmfun maxima::$anmech_evaluated (registers numbers)
  "anmech_evaluated(evaluator, [number, ...]): the list of the values, doubles."
  (replace (registers-numbers registers) (the double-array (exact-doubles (rest numbers))))
  (with-value-errors (lambda () (run-registers registers)))
  (numbers-list (result-list registers)))

(maxima::defmfun maxima::$anmech_evaluate (expressions variables numbers)
  "anmech_evaluate([expr, ...], [variable, ...], [number, ...]): the list of the values, doubles."
  (numbers-list (first (evaluated (rest expressions) (rest variables) (list (exact-doubles (rest numbers)))))))

(maxima::defmfun maxima::$anmech_solved_by_numbers (equations inputs numbers)
  "anmech_solved_by_numbers(equations, inputs, numbers): the unknowns of A u = b, doubles; EQUATIONS are the entries of
A and b in the inputs.  False if A is singular."
  (let* ((size (isqrt (length (rest equations))))
         (entries (doubles (first (evaluated (rest equations) (rest inputs) (list (exact-doubles (rest numbers)))))))
         (solution (subseq entries (* size size))))
    (and (solve-linear-in-place size entries solution) (numbers-list solution))))

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
