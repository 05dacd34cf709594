;;; anmech: linear differential expressions in undefined functions, taken apart.
;;;
;;; The conditions for a symmetry are linear in the components of the generator and their derivatives.  With undefined
;;; functions u(t, x) for components they are the determining equations; here they become lists of terms
;;; [coefficient, number of the function, orders of differentiation], with which the rest of the kernel works.
;;;
;;; Entry points: anmech_linear_terms, anmech_left_sides.

(in-package :anmech)
(needs "session/patience" "session/scope" "algebra/jets" "algebra/rootsums" "algebra/terms")

(defun unknown-place (form unknowns variables)
  "(number of the unknown . orders) if FORM is one of UNKNOWNS or a derivative of it; else nil."
  (let* ((derivative (operator-p form 'maxima::%derivative))
         (number (position (if derivative (second form) form) unknowns :test #'maxima::alike1)))
    (when number
      (let ((orders (make-list (length variables) :initial-element 0)))
        (when derivative
          (loop for (variable order) on (cddr form) by #'cddr
                do (incf (nth (position variable variables :test #'maxima::alike1) orders) order)))
        (cons (1+ number) orders)))))

(defun with-places-named (form unknowns variables)
  "FORM with a symbol for every unknown and derivative of it; an alist of symbols and places."
  (let ((table '()))
    (labels ((walk (form)
               (if (atom form)
                   form
                   (let ((place (unknown-place form unknowns variables)))
                     (if place
                         (or (car (rassoc place table :test #'equal))
                             (let ((symbol (maxima::$gensym)))
                               (push (cons symbol place) table)
                               symbol))
                         (let ((parts (mapcar #'walk (rest form))))
                           (if (every #'eq parts (rest form))
                               form
                               (maxima::simplifya (cons (list (caar form)) parts) nil))))))))
      (let ((named (walk form)))
        (values named (nreverse table))))))

(defun linear-parts (form symbols)
  "FORM as a sum over SYMBOLS: an alist to lists of terms, nil standing for what is free of them; leaves if it is not
plainly linear."
  (flet ((free-p (form) (notany (lambda (symbol) (member symbol symbols :test #'eq)) (symbols-in form))))
    (labels ((walk (form)
               (poll)
               (cond ((atom form)
                      (cond ((eql form 0) '())
                            ((member form symbols :test #'eq) (list (list form 1)))
                            (t (list (list nil form)))))
                     ((eq (caar form) 'maxima::mplus) (joined-terms (mapcar #'walk (rest form))))
                     ((eq (caar form) 'maxima::mtimes) (product (rest form)))
                     ((free-p form) (list (list nil form)))
                     (t (throw 'not-linear :not-linear))))
             (product (factors)
               (let* ((parts (mapcar #'walk factors))
                      (linear (remove-if #'free-parts-p parts)))
                 (cond ((null linear) (list (list nil (apply #'product-of factors))))
                       ((rest linear) (throw 'not-linear :not-linear))
                       (t (let* ((place (position (first linear) parts :test #'eq))
                                 (others (append (subseq factors 0 place) (nthcdr (1+ place) factors))))
                            (loop for (symbol . terms) in (first linear)
                                  collect (list symbol (apply #'product-of (sum-of terms) others)))))))))
      (catch 'not-linear (walk form)))))

(defun free-parts-p (parts) (notany #'car parts))

(defun joined-terms (alists)
  "One alist of the lists of all of them."
  (let ((table (make-hash-table :test #'eq)) (keys '()))
    (dolist (alist alists)
      (loop for (key . terms) in alist
            do (multiple-value-bind (before known) (gethash key table)
                 (unless known (push key keys))
                 (setf (gethash key table) (append terms before)))))
    (loop for key in (nreverse keys) collect (cons key (gethash key table)))))

(defun coefficients-by-derivatives (form symbols)
  "The same for what is linear in another way; :not-linear if it is not."
  (let ((rest-of-form form))
    (append
     (loop for symbol in symbols
           for coefficient = (maxima::$diff form symbol)
           do (poll)
              (unless (every (lambda (symbol) (maxima::$freeof symbol coefficient)) symbols)
                (return-from coefficients-by-derivatives :not-linear))
              (setq rest-of-form (maxima::$substitute 0 symbol rest-of-form))
           collect (list symbol coefficient))
     (list (list nil rest-of-form)))))

(maxima::defmfun maxima::$anmech_linear_terms (form unknowns variables)
  "anmech_linear_terms(expr, [u(t, x), ...], [t, x]): the list of [coefficient, number of the unknown, orders]; false if
expr is not linear and homogeneous in the unknowns and their derivatives."
  (multiple-value-bind (named table) (with-places-named form (rest unknowns) (rest variables))
    (let* ((symbols (mapcar #'car table))
           (parts (linear-parts named symbols))
           (parts (if (eq parts :not-linear) (coefficients-by-derivatives named symbols) parts)))
      (and (listp parts)
           (eql 0 (maxima::$ratsimp (sum-of (cdr (assoc nil parts)))))
           (maxima-list (loop for (symbol . place) in table
                              for coefficient = (sum-of (cdr (assoc symbol parts)))
                              unless (eql coefficient 0)
                                collect (maxima-list (list coefficient (first place) (maxima-list (rest place))))))))))

(defun repeated-derivative (form variable order)
  "With the powers of roots that sums run over reduced: relations between the sums are seen then."
  (if (some-part #'root-sum-p form)
      (loop repeat order
            do (setq form (map-root-sums #'split-root-sum (partial-derivative form variable)))
            finally (return form))
      (maxima::$diff form variable order)))

(maxima::defmfun maxima::$anmech_left_sides (equations function number variables)
  "anmech_left_sides([[[coefficient, number, orders], ...], ...], f, i, [t, x]): the left sides with f for the unknown
of number i and 0 for the others."
  (let ((derivatives '()))
    (labels ((derivative (orders)
               (or (cdr (assoc orders derivatives :test #'equal))
                   (let ((value function))
                     (loop for variable in (rest variables) for order in orders
                           do (when (plusp order) (setq value (repeated-derivative value variable order))))
                     (push (cons orders value) derivatives)
                     value))))
      (maxima-list
       (loop for equation in (rest equations)
             collect (sum-of (loop for (nil coefficient index orders) in (rest equation)
                                   when (and (eql index number) (not (eql 0 (derivative (rest orders)))))
                                     collect (maxima::mul coefficient (derivative (rest orders))))))))))
