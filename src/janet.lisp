;;; anmech: how many solutions a system of linear homogeneous partial differential equations has.
;;;
;;; At a random point modulo a prime the coefficients are Taylor polynomials (series.lisp); the equations and their
;;; derivatives up to a total order q are then linear equations, modulo the prime, between the Taylor coefficients
;;; ("jets") of the unknown functions.  They are solved for jets of high order first, so that the rows left show the
;;; consequences of low order, integrability conditions among them.
;;;
;;; Why the answer is an upper bound.  Let J(q) jets have an order up to q, and r(q) be the rank of the equations up to
;;; that order.  A rank at a special point modulo a prime never exceeds the generic one.  If the jets of order s have
;;; full rank among themselves, those of all higher orders have it too, so near a generic point solutions are
;;; determined by their jets up to any order q >= s, and there are at most J(q) - r(q) of them.  So as many
;;; independent, verified solutions as that are all: this is a proof, as far as the relations between kernels that
;;; series.lisp lists are all there are. What is left out only loses rank: values of the velocities that are not
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
;;; The spectrum of d/dz, z being in no coefficient, is that of a matrix on the jets that remain free.  Its
;;; characteristic polynomial modulo primes, at random parameters, is taken apart into square-free parts, and their
;;; coefficients are interpolated as rational functions of the parameters.  It is checked at another point modulo
;;; another prime.
;;;
;;; Entry points: anmech_dimension, anmech_proved_dimension,
;;; anmech_characteristic.  They read [coefficient, i, [a1, .., aN]], a term of an equation, as
;;; coefficient * d^(a1+..+aN) u_i / dx1^a1 .. dxN^aN.
;;;
;;; Literature: M. Janet, J. Math. Pures Appl. 3 (1920) 65; W. M. Seiler, Involution (2010), chapters 4, 7 and 8; G.
;;; J. Reid, Algorithms for reducing a system of PDEs to standard form, determining the dimension of its solution
;;; space and calculating its Taylor series solution, Eur. J. Appl. Math. 2 (1991) 293; F. Schwarz, An algorithm for
;;; determining the size of symmetry groups, Computing 49 (1992) 95; H. Cohen, A Course in Computational Algebraic
;;; Number Theory (1993), 2.2.4 and 3.4.2.

(in-package :anmech)

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

;;; Rows.  A jet's column is FUNCTIONS times the number of its monomial plus the number of its function, so later
;;; columns are of higher order.

(defstruct echelon
  "PIVOTS: for each column nil or (columns . entries), the rest of a row whose leading entry there is 1.  LEVELS: the
order up to which the equations were when that row was found.  WORK: zeros."
  (pivots nil :type simple-vector) (levels nil :type residues) (work nil :type residues))

(declaim (ftype (function (fixnum t t) fixnum) eliminate-row))

(defun new-echelon (width &optional before)
  (let ((echelon (make-echelon :pivots (make-array width :initial-element nil)
                               :levels (make-array width :element-type 'fixnum :initial-element 0)
                               :work (make-array width :element-type 'fixnum :initial-element 0))))
    (when before
      (replace (echelon-pivots echelon) (echelon-pivots before))
      (replace (echelon-levels echelon) (echelon-levels before)))
    echelon))

(defun eliminate-row (top work pivots)
  "Reduce the row in WORK, whose last entry is at TOP; the column of what is then its last entry, or -1."
  (declare (fixnum top) (type residues work) (type simple-vector pivots))
  (with-fast-arithmetic
    (let ((lead -1) (prime *prime*))
      (declare (fixnum lead prime))
      (do ((column top (fix (- column 1))))
          ((< column 0) lead)
        (declare (fixnum column))
        (let ((value (aref work column)))
          (declare (fixnum value))
          (unless (= 0 value)
            (let ((row (svref pivots column)))
              (if row
                  (let ((columns (car row)) (entries (cdr row)) (factor (fix (- prime value))))
                    (declare (type residues columns entries) (fixnum factor))
                    (setf (aref work column) 0)
                    (for (k (length columns))
                      (let ((place (aref columns k)))
                        (declare (fixnum place))
                        (setf (aref work place) (plus-product (aref work place) factor (aref entries k) prime)))))
                  (when (< lead 0) (setq lead column))))))))))

(defun scatter (entries work &optional (factor 1))
  "Add FACTOR times ENTRIES, pairs of a column and a residue, to WORK; the last column."
  (declare (type residues work) (fixnum factor))
  (let ((top -1) (prime *prime*))
    (declare (fixnum top prime))
    (loop for (column . value) in entries
          do (setf (aref work column) (plus-product (aref work column) factor value prime))
             (when (> (the fixnum column) top) (setq top column)))
    top))

(defun gather (work top)
  "Take the entries out of WORK: an alist, the last column first."
  (declare (type residues work) (fixnum top))
  (let ((entries '()))
    (for (column (1+ top))
      (unless (= 0 (aref work column))
        (push (cons column (aref work column)) entries)
        (setf (aref work column) 0)))
    entries))

(defun absorb-row (top echelon level)
  "Whether the row in the work of ECHELON, whose last entry is at TOP, is a new one; if so it is in ECHELON now."
  (let* ((work (echelon-work echelon)) (lead (eliminate-row top work (echelon-pivots echelon))))
    (unless (< lead 0)
      (let* ((row (gather work lead)) (scale (inverse-residue (cdr (first row)))))
        (setf (svref (echelon-pivots echelon) lead)
              (cons (fixnums (mapcar #'car (rest row)))
                    (fixnums (mapcar (lambda (pair) (mod (* scale (cdr pair)) *prime*)) (rest row))))
              (aref (echelon-levels echelon) lead) level)
        t))))

(defun insert-row (entries echelon level)
  (absorb-row (scatter entries (echelon-work echelon)) echelon level))

(defun insert-rows (rows echelon level)
  "One row for each leading jet; then random combinations of all the others until two in succession are nothing new."
  (let ((others '()) (idle 0))
    (dolist (row rows)
      (when row
        (if (svref (echelon-pivots echelon) (reduce #'max row :key #'car))
            (push row others)
            (insert-row row echelon level))))
    (loop until (or (null others) (= idle 2))
          do (let ((top -1))
               (dolist (row others)
                 (setq top (max top (scatter row (echelon-work echelon) (random-residue)))))
               (if (absorb-row top echelon level) (setq idle 0) (incf idle))))))

(defun remainder (entries echelon)
  "ENTRIES without the leading jets, as an alist."
  (let* ((work (echelon-work echelon)) (top (scatter entries work)))
    (eliminate-row top work (echelon-pivots echelon))
    (gather work top)))

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
    (loop for (series function order) in terms
          do (let ((places (svref products order)) (orders (svref exponents order)))
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

(defun visit-fixed-part (node)
  "Evaluate what in NODE does not move, so that the point is left at once if that does not exist."
  (cond ((node-moving node) (mapc #'visit-fixed-part (node-parts node)))
        ((not (member (node-kind node) '(:base :independent))) (series-of node))))

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

(defun instances-somewhere (system place given)
  "A point, and the instances there.  Points of different PLACE, below 8, are random ones of different primes.  GIVEN
is an alist from nodes of parameters to integers, whose 24th powers they are."
  (dotimes (attempt 200 (complain "no point was found where all coefficients exist modulo a prime"))
    (let* ((prime (suitable-prime (+ place (* 8 (floor attempt 20)))))
           (point (new-point (+ attempt (* 1000 place)) prime)))
      (loop for (node . root) in given
            do (setf (gethash node (point-residues point)) (let ((*prime* prime)) (power-residue root 24))))
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
  "The derivatives of that order, as rows; for equations of low order, that of the system's lowest: so far the series
go."
  (let* ((functions (pde-system-functions system))
         (lowest (pde-system-lowest system))
         (monomials (monomials-up-to (pde-system-variables system) (max level (pde-system-highest system))))
         (rows (rows-at-samples instances functions)))
    (loop for row in (if (some #'cdr instances) (separated-rows rows) rows)
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

(defun completed (system place known &optional given)
  "The completion of SYSTEM at a point of that PLACE, and the point; if KNOWN solutions are known, no more than that
is asked."
  (multiple-value-bind (point instances) (instances-somewhere system place given)
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
      (values completion point))))

(defun dimension-of (system known)
  "An integer, or a vector: how many free functions there are of 0, 1, .. variables; and whether the integer is an upper
bound without doubt."
  (if (null (pde-system-equations system))
      (free-functions (make-list (pde-system-functions system) :initial-element '()) (pde-system-variables system))
      (let ((completion (completed system 0 known)))
        (cond ((completion-counts completion))
              ((completion-certain completion) (values (completion-dimension completion) t))
              (t (let ((again (completed system 1 known)))
                   (or (completion-counts again)
                       (max (completion-dimension completion) (completion-dimension again)))))))))

(defun call-with-system (function equations functions variables moving)
  (call-with-reader (rest variables) (rest moving) (rest equations)
                    (lambda ()
                      (let ((system (read-system (rest equations) functions (length (rest variables)))))
                        (settle-exponentials)
                        (funcall function system)))))

(defun maxima-list (elements)
  (cons '(maxima::mlist maxima::simp) elements))

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

;;; Polynomials modulo the prime: lists of residues, the constant one first, the last one not zero

(defun trimmed-polynomial (coefficients)
  (let ((end (position 0 coefficients :test-not #'eql :from-end t)))
    (if end (subseq coefficients 0 (1+ end)) '())))

(defun combined-polynomials (a factor b)
  "A + FACTOR * B."
  (trimmed-polynomial
   (loop for k below (max (length a) (length b))
         collect (mod (+ (or (nth k a) 0) (* factor (or (nth k b) 0))) *prime*))))

(defun divided-polynomial (a b)
  "Quotient and remainder."
  (let ((inverse (inverse-residue (first (last b)))) (quotient '()))
    (loop for shift from (- (length a) (length b)) downto 0
          do (let ((factor (mod (* inverse (or (nth (+ shift (length b) -1) a) 0)) *prime*)))
               (push factor quotient)
               (setq a (combined-polynomials a (- *prime* factor) (append (make-list shift :initial-element 0) b)))))
    (values (trimmed-polynomial quotient) a)))

(defun monic-polynomial (a)
  (combined-polynomials '() (inverse-residue (first (last a))) a))

(defun common-divisor (a b)
  (loop while b do (psetq a b b (nth-value 1 (divided-polynomial a b))))
  (monic-polynomial a))

(defun polynomial-slope (a)
  (trimmed-polynomial (loop for k from 1 for coefficient in (rest a) collect (mod (* k coefficient) *prime*))))

(defun square-free-parts (a)
  "An alist from multiplicities to monic polynomials, the product of whose powers is A, a monic one (Yun)."
  (let* ((slope (polynomial-slope a))
         (common (common-divisor a slope))
         (b (divided-polynomial a common))
         (d (combined-polynomials (divided-polynomial slope common) (1- *prime*) (polynomial-slope b))))
    (loop for multiplicity from 1
          while (rest b)
          append (let ((part (common-divisor b d)))
                   (setq b (divided-polynomial b part)
                         d (combined-polynomials (divided-polynomial d part) (1- *prime*)
                                                 (polynomial-slope b)))
                   (and (rest part) (list (cons multiplicity part)))))))

(defun characteristic-residues (matrix)
  "The characteristic polynomial of MATRIX, an array, which becomes a Hessenberg matrix."
  (let ((size (array-dimension matrix 0)))
    (flet ((add-row (to factor from)
             (dotimes (k size)
               (setf (aref matrix to k) (mod (+ (aref matrix to k) (* factor (aref matrix from k))) *prime*))))
           (add-column (to factor from)
             (dotimes (k size)
               (setf (aref matrix k to) (mod (+ (aref matrix k to) (* factor (aref matrix k from))) *prime*))))
           (exchange (i j)
             (dotimes (k size) (rotatef (aref matrix i k) (aref matrix j k)))
             (dotimes (k size) (rotatef (aref matrix k i) (aref matrix k j)))))
      (loop for m from 1 below (1- size)
            for pivot = (loop for i from m below size unless (= 0 (aref matrix i (1- m))) return i)
            do (when pivot
                 (unless (= pivot m) (exchange pivot m))
                 (let ((inverse (inverse-residue (aref matrix m (1- m)))))
                   (loop for i from (1+ m) below size
                         do (let ((factor (mod (* inverse (aref matrix i (1- m))) *prime*)))
                              (unless (= 0 factor)
                                (add-row i (- *prime* factor) m)
                                (add-column m factor i))))))))
    (let ((polynomials (list '(1))))                      ; of the leading blocks, the largest first
      (dotimes (m size (first polynomials))
        (let ((sum (combined-polynomials (cons 0 (first polynomials))
                                         (- *prime* (aref matrix m m)) (first polynomials)))
              (product 1))
          (loop for i from (1- m) downto 0
                for smaller in (rest polynomials)
                do (setq product (mod (* product (aref matrix (1+ i) i)) *prime*)
                         sum (combined-polynomials sum (mod (- (* product (aref matrix i m))) *prime*) smaller)))
          (push sum polynomials))))))

;;; The spectrum at one point

(defun translation-matrix (completion system direction)
  "The matrix of the derivative by the variable of number DIRECTION on the jets that are free."
  (let* ((functions (pde-system-functions system))
         (monomials (monomials-up-to (pde-system-variables system) (completion-level completion)))
         (echelon (completion-echelon completion))
         (free (loop for column from 0
                     for number = (floor column functions)
                     while (< (aref (monomials-degrees monomials) number) (completion-order completion))
                     unless (svref (echelon-pivots echelon) column) collect column))
         (matrix (make-array (list (length free) (length free)) :initial-element 0)))
    (loop for column in free
          for row from 0
          do (multiple-value-bind (number function) (floor column functions)
               (let ((next (aref (the residues (svref (monomials-products monomials) number))
                                 (nth direction (monomials-units monomials))))
                     (factor (1+ (nth direction (svref (monomials-exponents monomials) number)))))
                 (loop for (place . entry) in (remainder (list (cons (+ function (* functions next)) factor)) echelon)
                       do (setf (aref matrix row (position place free)) entry)))))
    matrix))

(defstruct spectrum
  "Of a system at some VALUES of its parameters modulo PRIME: PATTERN, lists of multiplicity and degree of the
square-free parts of the characteristic polynomial, and COEFFICIENTS of all of these, which are monic."
  prime values pattern coefficients)

(defun spectrum-at (system direction place known given)
  "A spectrum, or nil where there are infinitely many solutions."
  (multiple-value-bind (completion point) (completed system place known given)
    (when (completion-dimension completion)
      (let* ((*prime* (point-prime point))
             (parts (square-free-parts (characteristic-residues (translation-matrix completion system direction)))))
        (make-spectrum :prime *prime*
                       :values (mapcar (lambda (pair) (gethash (car pair) (point-residues point))) given)
                       :pattern (loop for (multiplicity . part) in parts collect (list multiplicity (1- (length part))))
                       :coefficients (loop for (nil . part) in parts append (butlast part)))))))

;;; Interpolation.  A rational function is (exponents of the numerator, those of the denominator, coefficients of both).

(defparameter *most-spectra* 120 "So many values of the parameters are tried at most.")

(defun monomial-residue (exponents values)
  (let ((product 1))
    (loop for exponent in exponents
          for value in values
          do (setq product (mod (* product (power-residue value exponent)) *prime*)))
    product))

(defun null-vector (rows)
  "The first vector that ROWS, lists of residues, annihilate, its last entry that is not zero being 1; or nil."
  (let* ((width (length (first rows))) (echelon (new-echelon width)))
    ;; columns are eliminated from the last one: so the first column is written last
    (dolist (row rows)
      (insert-row (loop for entry in row for k downfrom (1- width) collect (cons k entry)) echelon 0))
    (let ((free (loop for k downfrom (1- width) to 0 unless (svref (echelon-pivots echelon) k) return k)))
      (when free
        (let ((vector (make-array width :initial-element 0)))
          (setf (aref vector free) 1)
          (loop for k from (1+ free) below width
                for (columns . entries) = (svref (echelon-pivots echelon) k)
                do (setf (aref vector k)
                         (mod (- (loop for column across columns
                                       for entry across entries sum (* entry (aref vector column))))
                              *prime*)))
          (nreverse (coerce vector 'list)))))))

(defun fitted (numerator denominator points)
  "The rational function of these monomials with the values at POINTS, pairs of the parameters' values and the value;
or nil."
  (let ((vector (null-vector (loop for (values . value) in points
                                   collect (append (mapcar (lambda (exponents) (monomial-residue exponents values))
                                                           numerator)
                                                   (mapcar (lambda (exponents)
                                                             (mod (- (* value (monomial-residue exponents values)))
                                                                  *prime*))
                                                           denominator))))))
    (and vector (some #'plusp (nthcdr (length numerator) vector))
         (list numerator denominator vector))))

(defun ansatz-list (count)
  "Lists of numerators' and denominators' monomials in COUNT parameters, the small ones first."
  (if (= count 0)
      '(((()) (())))
      (flet ((monomials (degree) (coerce (monomials-exponents (monomials-up-to count degree)) 'list))
             (size (ansatz) (+ (length (first ansatz)) (length (second ansatz)))))
        (sort (remove-if (lambda (ansatz) (> (+ 2 (size ansatz)) *most-spectra*))
                         (loop for degree from 0 to 12
                               append (loop for lower from 0 to degree
                                            when (or (= lower 0) (<= (- degree lower) 2))
                                              collect (list (monomials degree) (monomials lower))
                                              and when (< lower degree)
                                                    collect (list (monomials lower) (monomials degree)))))
              #'< :key #'size))))

(defun interpolated (count sample)
  "Rational functions of COUNT parameters for all coefficients of the spectra (funcall SAMPLE k), or nil."
  (let* ((spectra (list (funcall sample 0)))
         (size (length (spectrum-coefficients (first spectra))))
         (found (make-list size :initial-element nil)))
    (loop for (numerator denominator) in (ansatz-list count)
          for needed = (if (= count 0) 1 (+ 2 (length numerator) (length denominator)))
          do (loop while (< (length spectra) needed)
                   do (push (or (funcall sample (length spectra)) (return-from interpolated nil)) spectra))
             (setq found (loop for function in found
                               for k from 0
                               collect (or function (fitted numerator denominator (values-at k spectra)))))
          until (notany #'null found))
    (and (notany #'null found) found)))

(defun values-at (k spectra)
  "The values of the coefficient of number K: pairs of the parameters' values and its own."
  (loop for spectrum in spectra
        collect (cons (spectrum-values spectrum) (nth k (spectrum-coefficients spectrum)))))

;;; Integers from residues

(defun rational-from-residue (residue modulus)
  "The rational number of small numerator and denominator that is RESIDUE modulo MODULUS, or nil."
  (let ((bound (isqrt (floor modulus 2))) (a modulus) (b residue) (u 0) (v 1))
    (loop while (> b bound)
          do (let ((quotient (floor a b)))
               (psetq a b b (- a (* quotient b))
                      u v v (- u (* quotient v)))))
    (and (<= (abs v) bound) (/= v 0) (= 1 (gcd v modulus)) (/ b v))))

(defun joined-residue (a modulus b prime)
  "What is A modulo MODULUS and B modulo PRIME."
  (mod (+ a (* modulus (mod (* (- b a) (inverse-modulo modulus prime)) prime))) (* modulus prime)))

(defun value-of-function (function values)
  (destructuring-bind (numerator denominator coefficients) function
    (flet ((value (exponents coefficients)
             (loop for e in exponents
                   for coefficient in coefficients
                   sum (* (number-residue coefficient) (monomial-residue e values)))))
      (mod (* (value numerator coefficients)
              (inverse-residue (mod (value denominator (nthcdr (length numerator) coefficients)) *prime*)))
           *prime*))))

(defun agrees-p (functions spectrum)
  "Whether FUNCTIONS, with rational coefficients, have the coefficients of SPECTRUM for values."
  (let ((*prime* (spectrum-prime spectrum)))
    (equal (spectrum-coefficients spectrum)
           (catch 'point
             (mapcar (lambda (function) (value-of-function function (spectrum-values spectrum))) functions)))))

(defun with-coefficients (function next)
  (list (first function) (second function) (mapcar next (third function))))

(defun reconstructed (functions modulus)
  "FUNCTIONS with rational coefficients, or nil."
  (let ((rational (mapcar (lambda (function)
                            (with-coefficients function (lambda (residue) (rational-from-residue residue modulus))))
                          functions)))
    (and (notany (lambda (function) (member nil (third function))) rational) rational)))

(defun joined-functions (functions modulus others prime)
  "FUNCTIONS modulo MODULUS and the same ones, OTHERS, modulo PRIME: modulo the product."
  (mapcar (lambda (function other)
            (list (first function) (second function)
                  (mapcar (lambda (a b) (joined-residue a modulus b prime)) (third function) (third other))))
          functions others))

;;; The characteristic polynomial

(defun parameter-nodes ()
  (sort (loop for node being the hash-values of (reader-nodes *reader*)
              when (and (eq (node-kind node) :symbol) (not (node-moving node))) collect node)
        #'string< :key (lambda (node) (plain-name (node-data node)))))

(defun parameter-root (seed place)
  "An integer whose power a parameter is; small numbers would be met by accident."
  (+ 1000 (mod (* (+ 1 seed) 7368787 (+ 1 place place)) 1000003)))

(defun given-values (parameters seed)
  "An alist from PARAMETERS to integers."
  (loop for node in parameters
        for place from 0 collect (cons node (parameter-root seed place))))

(defun relevant-parameters (system direction known given first)
  "The parameters in GIVEN with which the spectrum changes, which is FIRST for their values there."
  (loop for (node . root) in given
        for other = (spectrum-at system direction 0 known (substitute (cons node (+ root 1)) node given :key #'car))
        unless (and (= (spectrum-prime other) (spectrum-prime first))
                    (equal (spectrum-coefficients other) (spectrum-coefficients first)))
          collect node))

(defun sampler (system direction known relevant others first)
  "A function (place seed) that gives spectra at random values of the parameters RELEVANT, the OTHERS as they were for
FIRST, for each place those modulo one prime and with the pattern of FIRST; nil if there are none."
  (let ((primes (list (cons 0 (spectrum-prime first)))))
    (lambda (place seed)
      (loop for further from (1+ seed) by 997
            repeat 20
            do (let* ((spectrum (spectrum-at system direction place known
                                          (append (given-values relevant further) others)))
                      (prime (or (cdr (assoc place primes))
                                 (cdar (push (cons place (spectrum-prime spectrum)) primes)))))
                 (when (and (= prime (spectrum-prime spectrum))
                            (equal (spectrum-pattern spectrum) (spectrum-pattern first)))
                   (setf (spectrum-values spectrum) (subseq (spectrum-values spectrum) 0 (length relevant)))
                   (return spectrum)))))))

(defun rational-functions (count sample)
  "Rational functions of COUNT parameters, with rational coefficients, for the coefficients of the spectra that the
function SAMPLE gives; nil if there are none."
  (let ((functions '()) (modulus 1))
    (dotimes (place 7)
      (let* ((spectrum (funcall sample place 0))
             (*prime* (if spectrum (spectrum-prime spectrum) (return nil)))
             (found (interpolated count (lambda (seed) (funcall sample place seed))))
             (joined (cond ((null found) (return nil))
                           (functions (joined-functions functions modulus found *prime*))
                           (t found))))
        (setq functions joined modulus (* modulus *prime*))
        (let ((rational (reconstructed functions modulus)) (check (funcall sample (1+ place) 0)))
          (when (and rational check (agrees-p rational check))
            (return rational)))))))

(defun spectral-functions (system direction)
  "Pattern of the spectrum, rational functions for all coefficients, and their parameters; nil if they were not found."
  (let* ((parameters (given-values (parameter-nodes) 0))
         (dimension (dimension-of system -1))
         (first (and (integerp dimension) (spectrum-at system direction 0 dimension parameters))))
    (cond
      ((eql dimension 0) (list '() '() '()))
      (first
       (let* ((relevant (relevant-parameters system direction dimension parameters first))
              (others (remove-if (lambda (pair) (member (car pair) relevant)) parameters))
              (functions (rational-functions (length relevant)
                                             (sampler system direction dimension relevant others first))))
         (and functions (list (spectrum-pattern first) functions (mapcar #'node-data relevant))))))))

(defun function-form (function parameters)
  "A rational function of Maxima."
  (destructuring-bind (numerator denominator coefficients) function
    (flet ((polynomial (monomials coefficients)
             (sum-of (loop for exponents in monomials
                           for coefficient in coefficients
                           collect (apply #'product-of (number-form coefficient)
                                          (mapcar #'power-of parameters exponents))))))
      (maxima::resimplify
       (maxima::$ratsimp (maxima::div (polynomial numerator coefficients)
                                      (polynomial denominator (nthcdr (length numerator) coefficients))))))))

(maxima::defmfun maxima::$anmech_characteristic (equations functions variables moving direction eigenvalue)
  "anmech_characteristic(equations, m, x, v, z, lambda): the characteristic polynomial in lambda, as a product of
powers of square-free ones, of the derivative by z on the space of solutions; z is one of x that is in no coefficient.
false if there are infinitely many solutions, if the coefficients are no rational functions of the parameters, or if
they are of a degree that needs more than some hundred values of the parameters."
  (let ((place (position direction (rest variables) :test #'maxima::alike1)))
    (unless (and place (maxima::$freeof direction (maxima-list (rest equations))))
      (complain "~a must be one of the variables, and in no coefficient" (one-line direction)))
    (let ((found (call-with-system (lambda (system) (spectral-functions system place))
                                   equations functions variables moving)))
      (and found
           (destructuring-bind (pattern coefficients parameters) found
             (apply #'product-of
                    (loop for (multiplicity degree) in pattern
                          collect (power-of
                                   (sum-of (cons (power-of eigenvalue degree)
                                                 (loop for k below degree
                                                       collect (maxima::mul
                                                                (function-form (pop coefficients) parameters)
                                                                (power-of eigenvalue k)))))
                                   multiplicity))))))))
