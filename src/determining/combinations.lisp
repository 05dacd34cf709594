;;; anmech: which combinations of given functions can solve a linear differential system, modulo a prime.
;;;
;;; An ansatz of hundreds of functions has a few solutions.  At random points, modulo a prime, the equations become
;;; linear equations between the constants of the ansatz (residues.lisp has the arithmetic, sparse.lisp the
;;; elimination).  Their rank is never more than the true one, so no solution is missed; and the functions that occur
;;; in solutions at all are soon few enough for the exact elimination of relations.lisp.
;;;
;;; Entry point: anmech_candidates.

(in-package :anmech)
(needs "session/texts" "arithmetic/residues" "arithmetic/series" "algebra/nodes" "algebra/sparse" "algebra/terms"
       "determining/janet")

(defun ansatz-rows (terms functions count)
  "The rows that equations are at a point: TERMS are lists of (node number place factor), FUNCTIONS the series of the
ansatz, each for COUNT unknowns, which change fastest."
  (let ((row '()))
    (loop for (node number place factor) in terms
          for value = (mod (* factor (constant-part (series-of node))) *prime*)
          do (loop for series in functions
                   for column from number by count
                   for entry = (mod (* value (aref (the residues series) place)) *prime*)
                   unless (= 0 entry)
                     do (push (cons column entry) row)))
    row))

(defun terms-at-place (equation monomials)
  "What EQUATION is made of: lists of (node number place factor); the factor is that between a Taylor coefficient and a
derivative."
  (loop for (nil coefficient number orders) in (rest equation)
        collect (list (coefficient-node coefficient) (1- number)
                      (position (rest orders) (monomials-exponents monomials) :test #'equal)
                      (falling-product (make-list (length (rest orders)) :initial-element 0) (rest orders)))))

(defun coefficients-of (equations)
  (loop for equation in (rest equations)
        append (mapcar #'second (rest equation))))

(defun highest-order (equations)
  (loop for equation in equations
        maximize (loop for (nil nil nil orders) in (rest equation) maximize (reduce #'+ (rest orders)))))

(defun fixed-p (node)
  "Whether NODE holds no variable."
  (and (not (eq (node-kind node) :variable)) (every #'fixed-p (node-parts node))))

(defun visit-parameters (node)
  "Evaluate what in NODE holds no variable."
  (cond ((member (node-kind node) '(:base :independent)))
        ((fixed-p node) (series-of node))
        (t (mapc #'visit-parameters (node-parts node)))))

(defun parameters-somewhere (nodes monomials)
  "A point at which all that is free of variables exists.  Each attempt has a prime of its own: modulo one without a
cube root of 2 there is none at any point."
  (loop for seed from 1 to 200
        for point = (new-point seed (suitable-prime (1- seed)))
        unless (eq :left (at-point point monomials (lambda () (mapc #'visit-parameters nodes))))
          return point
        finally (complain "no prime was found modulo which all constants exist")))

(defun point-with-same-parameters (seed before)
  "A random point at which all that is free of variables is what it was at the point BEFORE: the constants of a
solution hold parameters, so these must not change from point to point."
  (let ((point (new-point seed (point-prime before))))
    (setf (point-functions point) (point-functions before))
    (maphash (lambda (node residue)
               (when (fixed-p node) (setf (gethash node (point-residues point)) residue)))
             (point-residues before))
    point))

(defun ansatz-echelon (equations functions count variables)
  "The rows of the equations at so many points that two more add nothing."
  (let* ((monomials (monomials-up-to variables (highest-order equations)))
         (echelon (new-echelon (* count (length functions))))
         (equations (mapcar (lambda (equation) (terms-at-place equation monomials)) equations))
         (nodes (let ((*root-sums-linear* t)) (mapcar #'coefficient-node functions))))
    (settle-exponentials)
    (let* ((coefficients (loop for terms in equations append (mapcar #'first terms)))
           (before (parameters-somewhere (append coefficients nodes) monomials))
           (*prime* (point-prime before)) (idle 0))
      (loop for seed from 1
            until (= idle 2)
            do (when (> seed 2000) (complain "no points were found where all coefficients exist modulo a prime"))
               (let* ((point (point-with-same-parameters seed before))
                      (grown (at-point point monomials
                                       (lambda ()
                                         (let ((series (mapcar #'series-of nodes)))
                                           (count-if (lambda (terms)
                                                       (insert-row (ansatz-rows terms series count) echelon 0))
                                                     equations))))))
                 (cond ((eq grown :left))
                       ((= 0 grown) (incf idle))
                       (t (setq idle 0)))
                 (unless (eq grown :left) (setq before point)))))
    echelon))

(maxima::defmfun maxima::$anmech_candidates (equations count functions variables)
  "anmech_candidates(equations, m, [f, ...], [t, x]): equations as in anmech_left_sides, for m unknown functions that
are combinations of the f.  [dimension of the space of solutions at most, list of the [i, f] that can occur in them]."
  (let* ((functions (rest functions))
         (echelon (call-with-reader (rest variables) '()
                                    (append functions (coefficients-of equations))
                                    (lambda ()
                                      (ansatz-echelon (rest equations) functions count (length (rest variables)))))))
    (maxima-list
     (list (count nil (echelon-pivots echelon))
           (maxima-list (loop for column in (occurring-columns echelon)
                              collect (maxima-list (list (1+ (mod column count))
                                                         (nth (floor column count) functions)))))))))
