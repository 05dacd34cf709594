;;; anmech: an expression to second order about a point.
;;;
;;; The point is put in at the leaves, and the expansion is carried up through sums, products, powers and functions,
;;; higher terms being dropped on the way.  Nothing is differentiated or expanded as a whole: a Lagrangian whose second
;;; derivatives would have millions of terms costs little more than its evaluation.
;;;
;;; Entry point: anmech_expansion.
;;;
;;; Source: A. Griewank, A. Walther, Evaluating Derivatives (2008), chapter 13 (Taylor arithmetic).

(in-package :anmech)
(needs "session/outcomes" "session/texts" "algebra/kinks" "algebra/terms")

(defvar *expansion-order* 2 "1 or 2: terms of higher degree are dropped.")
(defvar *expansion-leaves* nil "Hash table from a variable to its expansion.")
(defvar *expansion-known* nil "Hash table from a part of the expression to its expansion: parts are often shared.")
(defvar *expansion-values* nil "The point, as Maxima equations.")

(defstruct (expansion (:constructor make-expansion (constant &optional linear quadratic (varies t))))
  "The value CONSTANT, the first derivatives LINEAR, a list of (i . derivative), and the second ones QUADRATIC, a list
of (key . derivative) with a key for each pair of variables; those that vanish are left out.  VARIES is false for a true
constant, all of whose derivatives vanish everywhere."
  constant linear quadratic varies)

(defun constant-expansion (form)
  (make-expansion form '() '() nil))

(defconstant +most-expansion-variables+ 4096)

(defun pair-key (i j)
  (+ (* +most-expansion-variables+ (min i j)) (max i j)))

(defun merged-terms (terms)
  "TERMS, a list of (key . coefficient), with one coefficient for each key."
  (let ((table (make-hash-table)) (keys '()))
    (loop for (key . coefficient) in terms
          do (unless (gethash key table) (push key keys))
             (push coefficient (gethash key table)))
    (loop for key in (nreverse keys)
          for coefficient = (let ((parts (gethash key table))) (if (rest parts) (sum-of parts) (first parts)))
          unless (eql coefficient 0)
            collect (cons key coefficient))))

(defun scaled-terms (factor terms)
  (cond ((eql factor 0) '())
        ((eql factor 1) terms)
        (t (loop for (key . coefficient) in terms collect (cons key (product-of factor coefficient))))))

(defun cross-terms (first second)
  "d1 u d2 v + d2 u d1 v, from the first derivatives of u and v."
  (and (= *expansion-order* 2)
       (loop for (i . a) in first
             append (loop for (j . b) in second
                          collect (cons (pair-key i j) (if (= i j) (product-of 2 a b) (product-of a b)))))))

(defun square-terms (linear)
  "d1 u d2 u."
  (loop for ((i . a) . more) on linear
        append (loop for (j . b) in (cons (cons i a) more) collect (cons (pair-key i j) (product-of a b)))))

(defun add-expansions (list)
  (make-expansion (sum-of (mapcar #'expansion-constant list))
                  (merged-terms (loop for u in list append (expansion-linear u)))
                  (merged-terms (loop for u in list append (expansion-quadratic u)))
                  (some #'expansion-varies list)))

(defun multiply-expansions (u v)
  (let ((a (expansion-constant u)) (b (expansion-constant v)))
    (make-expansion (product-of a b)
                    (merged-terms (append (scaled-terms b (expansion-linear u)) (scaled-terms a (expansion-linear v))))
                    (merged-terms (append (scaled-terms b (expansion-quadratic u))
                                          (scaled-terms a (expansion-quadratic v))
                                          (cross-terms (expansion-linear u) (expansion-linear v))))
                    (or (expansion-varies u) (expansion-varies v)))))

(defun compose-expansion (derivative u)
  "The expansion of f(u); (funcall DERIVATIVE k) is the k-th derivative of f at the constant of U.  It is asked for only
where it is needed: a root has a value where it has no derivative."
  (let ((slope (if (expansion-varies u) (funcall derivative 1) 0))
        (curvature (if (and (expansion-linear u) (= *expansion-order* 2)) (funcall derivative 2) 0)))
    (make-expansion (funcall derivative 0)
                    (scaled-terms slope (expansion-linear u))
                    (merged-terms (append (scaled-terms slope (expansion-quadratic u))
                                          (and (not (eql curvature 0))
                                               (scaled-terms curvature (square-terms (expansion-linear u))))))
                    (expansion-varies u))))

;;; Up through an expression

(defun expand-form (form)
  (cond ((atom form) (or (gethash form *expansion-leaves*) (constant-expansion form)))
        (t (or (gethash form *expansion-known*)
               (setf (gethash form *expansion-known*) (expand-operation form))))))

(defun expand-operation (form)
  (case (caar form)
    (maxima::mplus (add-expansions (mapcar #'expand-form (rest form))))
    (maxima::mtimes (reduce #'multiply-expansions (mapcar #'expand-form (rest form))))
    (maxima::mexpt (expand-power (expand-form (second form)) (expand-form (third form))))
    ((maxima::mabs maxima::%signum) (expand-kink form (expand-form (second form))))
    (t (if (member (caar form) *written-by-signs*)
           (expand-by-signs form)
           (expand-otherwise form)))))

(defun expand-otherwise (form)
  (if (and (null (cddr form)) (get (caar form) 'maxima::grad))
      (expand-function (caar form) (expand-form (second form)))
      (expand-unknown form)))

(defun expand-by-signs (form)
  (let ((signs (by-signs form)))
    (if (eq signs form) (maxima::merror "no expansion") (expand-form signs))))

(defun expand-kink (form u)
  "abs or signum of u: as for the sign that u has at the point; there is none where u vanishes and varies."
  (let ((b (expansion-constant u)) (operator (caar form)))
    (when (and (expansion-varies u) (maxima::zerop1 (maxima::$ratsimp b))) (maxima::merror "a kink"))
    (let ((value (maxima::simplify (list (list operator) b))))
      (if (or (eq operator 'maxima::%signum) (not (expansion-varies u)))
          (make-expansion value '() '() (expansion-varies u))
          (let ((sign (maxima::div b (abs-of b))))
            (make-expansion value (scaled-terms sign (expansion-linear u))
                            (scaled-terms sign (expansion-quadratic u))))))))

(defun expand-power (base exponent)
  (let ((b (expansion-constant base)) (n (expansion-constant exponent)))
    (if (not (expansion-varies exponent))
        (compose-expansion (lambda (k) (power-derivative b n k)) base)
        (expand-function 'maxima::%exp
                         (multiply-expansions exponent (expand-function 'maxima::%log base))))))

(defun power-derivative (b n k)
  "The K-th derivative of b^n.  Where the power falls to 0 nothing is said of b, which may vanish."
  (let ((factor (apply #'product-of (loop for i below k collect (maxima::sub n i)))) (power (maxima::sub n k)))
    (cond ((eql factor 0) 0)
          ((eql power 0) factor)
          (t (product-of factor (power-of b power))))))

(defun exponential (argument) (power-of 'maxima::$%e argument))

(defun expand-function (operator u)
  "A function of one argument whose derivative Maxima knows."
  (compose-expansion
   (lambda (k)
     (let ((point (expansion-constant u)) (dummy 'maxima::|$argument`|))
       (if (eq operator 'maxima::%exp)
           (exponential point)
           (let ((form (maxima::simplifya (list (list operator) dummy) t)))
             (loop repeat k do (setq form (maxima::sdiff form dummy)))
             (maxima::maxima-substitute point dummy form)))))
   u))

(defun expand-unknown (form)
  "Whatever else there is, by its partial derivatives: numbers, subscripted parameters, undefined functions, integrals."
  (let ((variables (loop for symbol in (symbols-in form)
                         for leaf = (gethash symbol *expansion-leaves*)
                         when leaf collect (cons (first (first (expansion-linear leaf))) symbol))))
    (unless variables (return-from expand-unknown (constant-expansion form)))
    (flet ((slopes (f)
             (loop for (i . symbol) in variables
                   for slope = (maxima::sdiff f symbol)
                   unless (eql slope 0) collect (cons i slope)))
           (at-point (terms)
             (loop for (key . f) in terms collect (cons key (value-at f)))))
      (let ((linear (slopes form)))
        (make-expansion (value-at form)
                        (at-point linear)
                        (and (= *expansion-order* 2)
                             (at-point (loop for (i . f) in linear
                                             append (loop for (j . second) in (slopes f)
                                                          when (<= i j) collect (cons (pair-key i j) second))))))))))

(defun value-at (form)
  "FORM at the point; a derivative of an undefined function stays one, taken there."
  (maxima::$at form *expansion-values*))

;;; The thin layer

(defun expansion-parts (u n)
  "[value, gradient] or [value, gradient, second derivatives as a matrix] of an expansion in N variables."
  (flet ((coefficient (key terms) (let ((pair (assoc key terms))) (if pair (cdr pair) 0))))
    (maxima-list
     (list* (expansion-constant u)
            (maxima-list (loop for i below n collect (coefficient i (expansion-linear u))))
            (and (= *expansion-order* 2)
                 (list (cons '(maxima::$matrix maxima::simp)
                             (loop for i below n
                                   collect (maxima-list
                                            (loop for j below n
                                                  collect (coefficient (pair-key i j) (expansion-quadratic u))))))))))))

(maxima::defmfun maxima::$anmech_expansion (form variables values order)
  "anmech_expansion(expr, [x, ...], [a, ...], order): [value, gradient] at x = a, for order 2 with the matrix of second
derivatives, nothing being expanded; none if expr or a derivative has no value there."
  (let ((*expansion-order* order)
        (*expansion-leaves* (make-hash-table :test #'eq))
        (*expansion-known* (make-hash-table :test #'eq))
        (*expansion-values* (maxima-list (loop for x in (rest variables)
                                               for a in (rest values)
                                               collect (list '(maxima::mequal maxima::simp) x a)))))
    (loop for x in (rest variables)
          for a in (rest values)
          for i from 0
          do (setf (gethash x *expansion-leaves*) (make-expansion a (list (cons i 1)))))
    (handler-case (with-maxima-errors (expansion-parts (expand-form form) (length (rest variables))))
      (maxima::maxima-$error () (maxima::$anmech_none)))))
