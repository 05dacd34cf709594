;;; anmech: solutions of linear equations of the second order that no elementary function gives.
;;;
;;;   linear_solution(k, q, x), k = 1 or 2,  is u_k(x),   u_1 and u_2 being two solutions of  d^2 u/ds^2 = q u  of which
;;;   linear_slope(k, q, x)                  is u_k'(x),  u_1 u_2' - u_1' u_2  is 1;  q is an expression in s = %s
;;;
;;; Each says what it is, so that nothing need be remembered beside an expression that holds them; %s belongs to them as
;;; %r belongs to sums over roots.  Which two solutions they are is left open: whatever is said of them holds for any
;;; two.
;;;
;;;   Derivatives    by x: linear_slope, and q(x) linear_solution.
;;;   Relations      the Wronskian, and no other as far as can be told: linear_slope(2, q, x) is
;;;                  (1 + u_1' u_2)/u_1 wherever something is to be decided.
;;;   Values         three functions like any other of what q is at a few places, and of x.
;;;   Series         of the solutions of the differential equation, with residues for u_1, u_2, u_1' at the point.
;;;
;;; Entry points: LINEAR-SOLUTION-P, WITHOUT-SECOND-SLOPES, LINEAR-SOLUTION-PARTS; anmech_formal_solution,
;;; anmech_without_second_slopes, anmech_linear_solutions_in.

(in-package :anmech)
(needs "arithmetic/approximate" "algebra/terms" "algebra/zero_test")

(defparameter *solution-operators* '(maxima::$linear_solution maxima::$linear_slope))

(defun linear-solution-p (form)
  (and (consp form) (consp (car form)) (member (caar form) *solution-operators*) (= (length form) 4)
       (member (second form) '(1 2))))

(defun linear-solution (operator k q place)
  (list (list operator 'maxima::simp) k q place))

(defun at-place (place form)
  "FORM, an expression in %s, at PLACE; what belongs to a solution inside of it stays."
  (cond ((eq form 'maxima::$%s) place)
        ((atom form) form)
        ((linear-solution-p form)
         (with-arguments form (list (second form) (third form) (at-place place (fourth form)))))
        (t (with-arguments form (mapcar (lambda (part) (at-place place part)) (rest form))))))

(defun linear-solution-parts (form)
  "Of a form the number of the solution, q in %s, the place, and q there."
  (destructuring-bind (k q place) (rest form)
    (values k q place (at-place place q))))

;;; Derivatives, as Maxima's diff takes them.  By what q holds there is none that is known.

(defparameter *solution-arguments* '(maxima::|$number`| maxima::|$factor`| maxima::|$place`|)
  "Maxima puts the arguments for these into the derivatives; so they are no names that can occur there.")

(flet ((unknown (operator place)
         (lambda (k q x)
           (let ((form (linear-solution operator k q x)))
             `((maxima::%derivative maxima::simp) ,form ,(nth place form) 1)))))
  (setf (get 'maxima::$linear_solution 'maxima::grad)
        (list *solution-arguments* (unknown 'maxima::$linear_solution 1)
              (unknown 'maxima::$linear_solution 2)
              (lambda (k q x) (linear-solution 'maxima::$linear_slope k q x)))
        (get 'maxima::$linear_slope 'maxima::grad)
        (list *solution-arguments* (unknown 'maxima::$linear_slope 1) (unknown 'maxima::$linear_slope 2)
              (lambda (k q x) (maxima::mul (at-place x q) (linear-solution 'maxima::$linear_solution k q x))))))

;;; The Wronskian

(defun without-second-slopes (form)
  "FORM with (1 + u_1' u_2)/u_1 for u_2'."
  (cond ((atom form) form)
        ((and (linear-solution-p form) (eq (caar form) 'maxima::$linear_slope) (eql (second form) 2))
         (destructuring-bind (q place) (cddr form)
           (flet ((part (operator k) (linear-solution operator k q place)))
             (maxima::div (maxima::add 1 (maxima::mul (part 'maxima::$linear_slope 1)
                                                      (part 'maxima::$linear_solution 2)))
                          (part 'maxima::$linear_solution 1)))))
        ((some-part #'linear-solution-p form)
         (with-arguments form (mapcar #'without-second-slopes (rest form))))
        (t form)))

;;; Values

(defun linear-solution-value (form)
  "FORM at the present point: q counts by its values at two places, so that it may be written in any way."
  (unless (linear-solution-p form) (undecided))
  (if (and (eq (caar form) 'maxima::$linear_slope) (eql (second form) 2))
      (point-value (without-second-slopes form))
      (destructuring-bind (k q place) (rest form)
        (flet ((q-at (value)
                 (let ((*bound-values* (acons 'maxima::$%s (cons value 0d0) *bound-values*))) (point-value q))))
          (unknown-value (format nil "~a ~d" (caar form) k) (list (q-at 0.37d0) (q-at 0.83d0) (point-value place))
                         '(0 0 0))))))

(dolist (operator *solution-operators*) (setf (get operator 'point-value) 'linear-solution-value))

;;; The thin layer

(maxima::defmfun maxima::$anmech_formal_solution (k q place)
  "anmech_formal_solution(k, q, t): linear_solution(k, q(%s), t) for q, an expression in t."
  (linear-solution 'maxima::$linear_solution k (maxima::$substitute 'maxima::$%s place q) place))

(maxima::defmfun maxima::$anmech_without_second_slopes (form)
  "anmech_without_second_slopes(expr): with (1 + u_1' u_2)/u_1 for u_2'."
  (without-second-slopes form))

(maxima::defmfun maxima::$anmech_linear_solutions_in (form)
  "anmech_linear_solutions_in(expr): the [q, x] of those that occur."
  (let ((found '()))
    (some-part (lambda (part)
                 (when (linear-solution-p part) (pushnew (maxima-list (cddr part)) found :test #'maxima::alike1))
                 nil)
               form)
    (maxima-list found)))
