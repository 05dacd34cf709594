;;; What rtest_mass_matrices.mac asks of the models of motions.

(in-package :anmech)

(maxima::defmfun maxima::$numerical_unknowns (model numbers)
  "numerical_unknowns(model, numbers): the unknowns for these inputs, exactly the doubles found; or a sentence."
  (let ((out (zeros (length (model-unknowns model)))))
    (handler-case
        (progn (funcall (the function (model-solver model)) (exact-doubles (rest numbers)) out)
               (cons '(maxima::mlist maxima::simp) (map 'list (lambda (u) (from-rational (rational u))) out)))
      (domain-violation (condition) (coerce (format nil "~a" condition) 'simple-string)))))

(defun elimination-of (model)
  (and (model-arrangement model) (arrangement-elimination (model-arrangement model))))

(maxima::defmfun maxima::$shape_of_model (model)
  "shape_of_model(model): [what is computed, entries of the matrix, those that elimination adds, symmetric, constant]."
  (let ((elimination (elimination-of model)))
    `((maxima::mlist maxima::simp)
      ,(length (model-equations model))
      ,@(and elimination
             (list (length (elimination-rows elimination)) (elimination-fill elimination)
                   (and (elimination-symmetric elimination) t)
                   (and (arrangement-constant (model-arrangement model)) t))))))

(maxima::defmfun maxima::$hastened_field_agrees (model points)
  "hastened_field_agrees(model, [[number, ...], ...]): whether the field that is compiled after many evaluations is
another one, and gives the same bits, or the same sentence, for these inputs."
  (flet ((rates (field numbers)
           (handler-case (let ((out (zeros (model-dimension model))))
                           (funcall (the function field) (exact-doubles (rest numbers)) out)
                           out)
             (domain-violation (condition) (format nil "~a" condition)))))
    (let ((field (model-field model)))
      (hasten-field model *worth-compiling*)
      (and (or (not (compiler-p)) (not (eq field (model-field model))))
           (every (lambda (numbers) (equalp (rates field numbers) (rates (model-field model) numbers)))
                  (rest points))))))
