;;; anmech: how many solutions a system of linear homogeneous partial differential equations has.
;;;
;;; At a random point modulo a prime the coefficients are Taylor polynomials (nodes.lisp); the equations and their
;;; derivatives up to a total order q are then linear equations, modulo the prime, between the Taylor coefficients
;;; ("jets") of the unknown functions.  They are solved for jets of high order first, so that the rows left show the
;;; consequences of low order, integrability conditions among them.
;;;
;;; Why the answer is an upper bound.  Let J(q) jets have an order up to q, and r(q) be the rank of the equations up to
;;; that order.  A rank at a special point modulo a prime never exceeds the generic one.  If the jets of order s have
;;; full rank among themselves, those of all higher orders have it too, so near a generic point solutions are
;;; determined by their jets up to any order q >= s, and there are at most J(q) - r(q) of them.  So as many
;;; independent, verified solutions as that are all: this is a proof, as far as the relations between kernels that
;;; nodes.lisp lists are all there are. What is left out only loses rank: values of the velocities that are not
;;; sampled, rows not drawn into a combination. Determining systems of point symmetries of second-order equations are
;;; of this sort.
;;;
;;; If however the jets of order s are determined only by consequences that come from higher orders, while others of
;;; those higher orders stay free, then the number of consequences of order < s is a difference of two ranks, the
;;; smaller of which may have dropped at this point.  So it is the generic one with high probability only (1 -
;;; degree/prime): then the count is made at two points with two primes, and the larger one counts.
;;;
;;; When to stop.  Finite dimension: all jets of order s are determined and one more prolongation gives nothing new up
;;; to order s; then the system of order s has symbol zero and its integrability conditions hold.  In general: the
;;; leading jets are multiples of some of them, and all S-pairs of those lie in the orders reached (Buchberger's
;;; criterion).  The monomials that are multiples of no leading one are then split into cones, and a cone of k
;;; directions is a free function of k variables (Janet).
;;;
;;; Entry points: anmech_dimension, anmech_proved_dimension.  They read [coefficient, i, [a1, .., aN]], a term of an
;;; equation, as  coefficient * d^(a1+..+aN) u_i / dx1^a1 .. dxN^aN.
;;;
;;; Literature: M. Janet, J. Math. Pures Appl. 3 (1920) 65; W. M. Seiler, Involution (2010), chapters 4, 7 and 8; G.
;;; J. Reid, Algorithms for reducing a system of PDEs to standard form, determining the dimension of its solution
;;; space and calculating its Taylor series solution, Eur. J. Appl. Math. 2 (1991) 293; F. Schwarz, An algorithm for
;;; determining the size of symmetry groups, Computing 49 (1992) 95.

(in-package :anmech)
(needs "session/texts" "arithmetic/residues" "arithmetic/series" "algebra/doubts" "algebra/nodes" "algebra/sparse"
       "algebra/terms")

(defparameter *most-jets* 4000 "A system that needs more jets than this is not decided.")

;;; Systems

(defstruct equation
  "TERMS: lists of a node, the number of a function, and the number of a monomial."
  order terms moving)

(defstruct pde-system
  "FUNCTIONS and VARIABLES: how many; LOWEST and HIGHEST: orders of EQUATIONS."
  functions variables equations lowest highest)

(defun read-equation (form functions variables)
  (let* ((terms (remove 0 (mapcar #'rest (rest form)) :key #'first :test #'eql))
         (orders (mapcar (lambda (term) (reduce #'+ (rest (third term)))) terms)))
    (dolist (term terms)
      (unless (and (= 3 (length term)) (<= 1 (second term) functions) (= variables (length (rest (third term)))))
        (complain "expected a term [coefficient, function, [orders]], found ~a"
                  (one-line (cons '(maxima::mlist) term)))))
    (when terms
      (let ((read (loop for (form function exponents) in terms
                        for order in orders
                        collect (list (coefficient-node form)
                                      (1- function)
                                      (position (rest exponents)
                                                (monomials-exponents (monomials-up-to variables order))
                                                :test #'equal)))))
        (make-equation :order (reduce #'max orders) :terms read
                       :moving (and (some (lambda (term) (node-moving (first term))) read) t))))))

(defun read-system (equations functions variables)
  (let ((read (remove nil (mapcar (lambda (form) (read-equation form functions variables)) equations))))
    (make-pde-system :functions functions :variables variables :equations read
                     :lowest (reduce #'min (mapcar #'equation-order read) :initial-value 64)
                     :highest (reduce #'max (mapcar #'equation-order read) :initial-value 0))))

;;; A jet's column is FUNCTIONS times the number of its monomial plus the number of its function, so later columns are
;;; of higher order.

;;; Derivatives of an equation, as rows

(defun falling-product (exponents orders)
  "(e+a)!/e!, the factor between Taylor coefficients of a function and those of its derivative."
  (let ((product 1))
    (loop for e in exponents
          for a in orders
          do (loop for k from (1+ e) to (+ e a) do (setq product (mod (* product k) *prime*))))
    product))

(defun derivative-rows (terms degree monomials functions)
  "A vector of the rows that the derivatives of order DEGREE of an equation are; TERMS are lists of a series, the
number of a function and that of a monomial, MONOMIALS reach to the order of the rows."
  (let* ((ends (monomials-ends monomials)) (products (monomials-products monomials))
         (exponents (monomials-exponents monomials)) (degrees (monomials-degrees monomials))
         (start (if (= degree 0) 0 (aref ends (1- degree))))
         (rows (make-array (- (aref ends degree) start) :initial-element '())))
    (declare (type residues ends degrees) (fixnum start))
    (loop for (coefficients function order) in terms
          do (let ((series coefficients) (places (svref products order)) (orders (svref exponents order)))
               (declare (type residues series places))
               (dotimes (e (aref ends degree))
                 (let* ((rest (- degree (aref degrees e)))
                        (factor (falling-product (svref exponents e) orders))
                        (column (+ function (* functions (aref places e))))
                        (targets (svref products e)))
                   (declare (type residues targets) (fixnum rest factor))
                   (loop for f from (if (= rest 0) 0 (aref ends (1- rest))) below (aref ends rest)
                         do (unless (= 0 (aref series f))
                              (push (cons column (mod (* factor (aref series f)) *prime*))
                                    (svref rows (- (aref targets f) start)))))))))
    rows))

;;; Which equations at which samples.  An instance is (equation . sample).

(defun evaluated-terms (equation)
  (mapcar (lambda (term) (cons (series-of (first term)) (rest term))) (equation-terms equation)))

(defun value-row (equation functions)
  (loop for (series function order) in (evaluated-terms equation)
        collect (cons (+ function (* functions order)) (constant-part series))))

(defun new-instances (equations sample functions echelon)
  "The instances at SAMPLE, in a list, that are independent at this point of those before."
  (at-sample sample
             (lambda ()
               (loop for equation in equations
                     when (insert-row (value-row equation functions) echelon 0)
                       collect (cons equation sample)))))

(defun sampled-instances (equations functions echelon)
  "Instances at random samples until two samples have added nothing."
  (dolist (equation equations)
    (dolist (term (equation-terms equation)) (visit-fixed-part (first term))))
  (let ((idle 0) (instances '()))
    (loop for attempt from 0
          until (= idle 2)
          do (when (> attempt 200) (leave-point))
             (let ((added (catch 'point (new-instances equations (make-hash-table :test #'eq) functions echelon))))
               (cond ((eq added :left))
                     ((null added) (incf idle))
                     (t (setq idle 0 instances (append instances added))))))
    instances))

(defun chosen-instances (system)
  (let* ((functions (pde-system-functions system))
         (echelon (new-echelon (* functions (monomials-count (monomials-up-to (pde-system-variables system)
                                                                              (pde-system-highest system))))))
         (fixed (remove-if #'equation-moving (pde-system-equations system)))
         (moving (remove-if-not #'equation-moving (pde-system-equations system))))
    (append (new-instances fixed nil functions echelon)
            (and moving (sampled-instances moving functions echelon)))))

(defun instances-somewhere (system place given &optional (turn 0))
  "A point, and the instances there.  Points of different PLACE, below 8, are random ones of different primes, those of
different TURN different ones.  GIVEN is an alist from nodes of parameters to integers, whose powers by the order of the
units they are."
  (dotimes (attempt 200 (complain "no point was found where all coefficients exist modulo a prime"))
    (let* ((prime (suitable-prime (+ place (* 8 (floor attempt 20)))))
           (point (new-point (+ attempt (* 1000 place) (* 100000 turn)) prime)))
      (loop for (node . root) in given
            do (setf (gethash node (point-residues point)) (let ((*prime* prime)) (power-residue root *unit-order*))))
      (let ((instances (at-point point (monomials-up-to (pde-system-variables system) 0)
                                 (lambda () (chosen-instances system)))))
        (unless (eq instances :left)
          (return (values point instances)))))))

;;; Completion

(defstruct completion
  "FREE: how many jets of each order are not determined.  DIMENSION: the number of solutions, nil if not known to be
finite; then all jets of order ORDER are determined.  CERTAIN: whether that number is a bound without doubt.  COUNTS:
how many free functions there are of 0, 1, .. variables."
  echelon level free order dimension certain counts)

(defun free-jets (echelon functions monomials)
  (let ((free (make-list (1+ (monomials-degree monomials)) :initial-element 0)))
    (dotimes (column (length (echelon-pivots echelon)) free)
      (unless (svref (echelon-pivots echelon) column)
        (incf (nth (aref (monomials-degrees monomials) (floor column functions)) free))))))

(defun divides-p (a b) (every #'<= a b))

(defun generators-of (function echelon functions monomials)
  "The leading monomials of FUNCTION that are not multiples of others: lists of level, exponents."
  (let ((generators '()))
    (loop for number from 0 below (monomials-count monomials)
          for column = (+ function (* functions number))
          for exponents = (svref (monomials-exponents monomials) number)
          do (when (and (svref (echelon-pivots echelon) column)
                        (notany (lambda (generator) (divides-p (second generator) exponents)) generators))
               (push (list (aref (echelon-levels echelon) column) exponents) generators)))
    generators))

(defun pair-orders (generators)
  "The orders of the least common multiples of all pairs."
  (loop for ((nil a) . others) on generators
        append (loop for (nil b) in others collect (reduce #'+ (mapcar #'max a b)))))

(defun closed-p (generators level)
  "Whether all S-pairs have been seen.  GENERATORS: a list for each function."
  (let ((delay (loop for list in generators
                     append (loop for (found exponents) in list collect (- found (reduce #'+ exponents))))))
    (>= level (+ (reduce #'max delay :initial-value 0)
                 (reduce #'max (mapcan #'pair-orders generators) :initial-value 0)))))

(defun add-cones (generators variables directions counts)
  "Split the monomials in VARIABLES variables that are multiples of none of GENERATORS into cones; add to COUNTS how
many there are of each number of directions, of which DIRECTIONS are given."
  (cond ((null generators) (incf (aref counts (+ directions variables))))
        ((notany (lambda (generator) (every #'zerop generator)) generators)
         (let ((top (reduce #'max (mapcar #'first generators))))
           (loop for e from 0 to top
                 do (add-cones (loop for generator in generators
                                     when (<= (first generator) e) collect (rest generator))
                               (1- variables) (if (= e top) (1+ directions) directions) counts))))))

(defun free-functions (generators variables)
  (let ((counts (make-array (1+ variables) :initial-element 0)))
    (dolist (list generators counts)
      (add-cones (mapcar #'second list) variables 0 counts))))

(defun completion-at (level echelon before known system)
  "The completion if it is one at LEVEL, BEFORE being how many jets were free one level earlier."
  (let* ((functions (pde-system-functions system))
         (variables (pde-system-variables system))
         (monomials (monomials-up-to variables level))
         (free (free-jets echelon functions monomials))
         (order (position 0 free))
         (dimension (and order (reduce #'+ (subseq free 0 order))))
         (certain (and order (= dimension (reduce #'+ free))))
         (generators (and (not order)
                          (loop for function below functions
                                collect (generators-of function echelon functions monomials)))))
    (flet ((complete (&optional counts)
             (make-completion :echelon echelon :level level :free free :order order :dimension dimension
                              :certain certain :counts counts)))
      (cond ((and order (or (and certain (<= dimension known))
                            (= order 0)
                            (and (> (length before) order)
                                 (equal (subseq before 0 (1+ order)) (subseq free 0 (1+ order))))))
             (values (complete) free))
            ((and (not order) (closed-p generators level))
             (values (complete (free-functions generators variables)) free))
            (t (values nil free))))))

(defun equation-row (equation functions)
  "An alist from columns to series, the last column first."
  (let ((row '()))
    (loop for (series function order) in (evaluated-terms equation)
          for column = (+ function (* functions order))
          for place = (assoc column row)
          do (if place
                 (setf (cdr place) (add-multiple (cdr place) 1 series))
                 (push (cons column series) row)))
    (sort row #'> :key #'car)))

(defun rows-at-samples (instances functions)
  "The rows of INSTANCES, sample by sample: what does not move is evaluated once."
  (loop for sample in (remove-duplicates (mapcar #'cdr instances) :test #'eq)
        append (at-sample sample
                          (lambda ()
                            (loop for (equation . its-sample) in instances
                                  when (eq its-sample sample) collect (equation-row equation functions))))))

(defun without-column (row pivot)
  "ROW without the leading column of PIVOT, a row whose entry there is 1."
  (let ((place (assoc (caar pivot) row)))
    (if place
        (remove-if #'zero-series-p
                   (merge-rows (remove place row :test #'eq) (cdr place) (rest pivot))
                   :key #'cdr)
        row)))

(defun merge-rows (row factor other)
  "ROW - FACTOR * OTHER, both alists with descending columns."
  (let ((result '()))
    (loop while other
          do (cond ((and row (> (caar row) (caar other))) (push (pop row) result))
                   (t (push (cons (caar other)
                                  (minus-series-product (if (and row (= (caar row) (caar other)))
                                                            (cdr (pop row))
                                                            (constant-series 0))
                                                        factor (cdar other)))
                            result)
                      (pop other))))
    (revappend result row)))

(defun separated-rows (rows)
  "Rows with the same solutions, solved for one column each: samples of an equation are what it was split into."
  (let ((pivots '()))
    (dolist (row rows pivots)
      (dolist (pivot pivots) (setq row (without-column row pivot)))
      (let ((leading (find-if-not #'zerop row :key (lambda (pair) (constant-part (cdr pair))))))
        (when leading
          (let* ((inverse (power-of-series (cdr leading) -1))
                 (scaled (loop for (column . series) in (remove leading row :test #'eq)
                               collect (cons column (multiply-series series inverse))))
                 (pivot (acons (car leading) (constant-series 1) scaled)))
            (setq pivots (cons pivot (mapcar (lambda (other) (without-column other pivot)) pivots)))))))))

(defun level-rows (level instances system)
  "The derivatives of that order, as rows."
  (let ((rows (rows-at-samples instances (pde-system-functions system))))
    (derivatives-of-rows (if (some #'cdr instances) (separated-rows rows) rows) level system)))

(defun derivatives-of-rows (rows level system)
  "The derivatives of that order of ROWS of series, for equations of low order that of the system's lowest: so far the
series go."
  (let* ((functions (pde-system-functions system))
         (lowest (pde-system-lowest system))
         (monomials (monomials-up-to (pde-system-variables system) (max level (pde-system-highest system)))))
    (loop for row in rows
          for terms = (loop for (column . series) in row
                            collect (list series (mod column functions) (floor column functions)))
          for order = (loop for (nil nil number) in terms maximize (aref (monomials-degrees monomials) number))
          for degree = (- level (max lowest order))
          unless (minusp degree)
            append (coerce (derivative-rows terms degree
                                            (monomials-up-to (pde-system-variables system) level) functions)
                           'list))))

(defun add-level (level echelon instances system)
  (insert-rows (level-rows level instances system) echelon level))

(defun completed (system place known &optional given (turn 0))
  "The completion of SYSTEM at a point of that PLACE and TURN, the point, and the instances; if KNOWN solutions are
known, no more than that is asked."
  (multiple-value-bind (point instances) (instances-somewhere system place given turn)
    (let ((echelon nil) (completion nil) (free '()))
      (loop for level from (pde-system-lowest system)
            for width = (* (pde-system-functions system)
                           (monomials-count (monomials-up-to (pde-system-variables system) level)))
            until completion
            do (when (> width *most-jets*)
                 (complain "the dimension of the solution space was not found with derivatives up to order ~d"
                           (1- level)))
               (setq echelon (new-echelon width echelon))
               (at-point point
                         (monomials-up-to (pde-system-variables system) (- level (pde-system-lowest system)))
                         (lambda () (add-level level echelon instances system) t))
               (when (>= level (pde-system-highest system))
                 (multiple-value-setq (completion free) (completion-at level echelon free known system))))
      (values completion point instances))))

(defun dimension-of (system known)
  "An integer, or a vector: how many free functions there are of 0, 1, .. variables; and whether the integer is an upper
bound without doubt."
  (if (null (pde-system-equations system))
      (free-functions (make-list (pde-system-functions system) :initial-element '()) (pde-system-variables system))
      (let ((completion (completed system 0 known)))
        (cond ((completion-counts completion))
              ((completion-certain completion) (values (completion-dimension completion) (not (doubtful-p))))
              (t (let ((again (completed system 1 known)))
                   (or (completion-counts again)
                       (max (completion-dimension completion) (completion-dimension again)))))))))

(defun call-with-system (function equations functions variables moving)
  (call-with-reader (rest variables) (rest moving) (rest equations)
                    (lambda ()
                      (let ((system (read-system (rest equations) functions (length (rest variables)))))
                        (settle-exponentials)
                        (funcall function system)))))

(defun dimension-form (dimension)
  (if (integerp dimension)
      dimension
      (maxima-list (list 'maxima::$inf
                         (maxima-list (loop for k from (1- (length dimension)) downto 1
                                            when (plusp (aref dimension k))
                                              collect (maxima-list (list (aref dimension k) k))))))))

(maxima::defmfun maxima::$anmech_dimension (equations functions variables moving &optional (known -1))
  "anmech_dimension(equations, m, x, v, [known]): the dimension of the solution space at generic parameters, or
[inf, [[number of functions, of how many variables], ...]].  An equation, a list of terms
[coefficient, i, [a1, .., aN]], holds for all x and all v.  If KNOWN solutions are known, an upper bound that
is not larger is an answer at once."
  (dimension-form
   (call-with-system (lambda (system) (values (dimension-of system known))) equations functions variables moving)))

(maxima::defmfun maxima::$anmech_proved_dimension (equations functions variables moving &optional (known -1))
  "anmech_proved_dimension(equations, m, x, v, [known]): [dimension, whether that is a proved upper bound]; as the
head of this file says, it is not if the system is finite only by integrability conditions of its leading terms."
  (multiple-value-bind (dimension certain)
      (call-with-system (lambda (system) (dimension-of system known)) equations functions variables moving)
    (maxima-list (list (dimension-form dimension) (and certain t)))))
