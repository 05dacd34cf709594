;;; anmech: how many solutions a system of linear homogeneous partial differential equations has.
;;;
;;; At a random point modulo a prime the coefficients are Taylor polynomials (series.lisp); the equations and their
;;; derivatives up to a total order q are then linear equations, modulo the prime, between the Taylor coefficients ("jets")
;;; of the unknown functions.  They are solved for jets of high order first, so that the rows left show the consequences of
;;; low order, integrability conditions among them.
;;;
;;; Why the answer is an upper bound.  Let J(q) jets have an order up to q, and r(q) be the rank of the equations up to
;;; that order.  A rank at a special point modulo a prime never exceeds the generic one.  If the jets of order s have full
;;; rank among themselves, those of all higher orders have it too, so near a generic point solutions are determined by their
;;; jets up to any order q >= s, and there are at most J(q) - r(q) of them.  So as many independent, verified solutions
;;; as that are all: this is a proof.  A sample of the equations for some values of the velocities only loses rank.
;;; Determining systems of point symmetries of second-order equations are of this sort.
;;;
;;; If however the jets of order s are determined only by consequences that come from higher orders, while others of those
;;; higher orders stay free, then the number of consequences of order < s is a difference of two ranks, and it is the
;;; generic one only with high probability (1 - degree/prime).  Then the count is made at two points with two primes, and
;;; the larger one counts.
;;;
;;; When to stop.  Finite dimension: all jets of order s are determined and one more prolongation gives nothing new up to
;;; order s; then the system of order s has symbol zero and its integrability conditions hold.  In general: the leading
;;; jets are multiples of some of them, and all S-pairs of those lie in the orders reached (Buchberger's criterion).  The
;;; monomials that are multiples of no leading one are then split into cones, and a cone of k directions is a free
;;; function of k variables (Janet).
;;;
;;; Entry points: anmech_dimension.  It reads [coefficient, i, [a1, .., aN]], a term of an equation, as
;;; coefficient * d^(a1+..+aN) u_i / dx1^a1 .. dxN^aN.
;;;
;;; Literature: M. Janet, J. Math. Pures Appl. 3 (1920) 65; W. M. Seiler, Involution (2010), chapters 4, 7 and 8; G. J. Reid,
;;; Algorithms for reducing a system of PDEs to standard form, determining the dimension of its solution space and
;;; calculating its Taylor series solution, Eur. J. Appl. Math. 2 (1991) 293; F. Schwarz, An algorithm for determining the
;;; size of symmetry groups, Computing 49 (1992) 95.

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

;;; Rows.  A jet's column is FUNCTIONS times the number of its monomial plus the number of its function, so later columns are
;;; of higher order.

(defstruct echelon
  "PIVOTS: for each column nil or (columns . entries), the rest of a row whose leading entry there is 1.  LEVELS: the order
up to which the equations were when that row was found.  WORK: zeros."
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

(defun scatter (entries work)
  "Add ENTRIES, pairs of a column and a residue, to WORK; the last column."
  (declare (type residues work))
  (let ((top -1))
    (loop for (column . value) in entries
          do (setf (aref work column) (mod (+ (aref work column) value) *prime*)
                   top (max top column)))
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

(defun insert-row (entries echelon level)
  "Whether ENTRIES are a new row; if so it is in ECHELON now."
  (let* ((work (echelon-work echelon))
         (lead (eliminate-row (scatter entries work) work (echelon-pivots echelon))))
    (unless (< lead 0)
      (let* ((row (gather work lead)) (scale (inverse-residue (cdr (first row)))))
        (setf (svref (echelon-pivots echelon) lead)
              (cons (fixnums (mapcar #'car (rest row)))
                    (fixnums (mapcar (lambda (pair) (mod (* scale (cdr pair)) *prime*)) (rest row))))
              (aref (echelon-levels echelon) lead) level)
        t))))

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
  "A vector of the rows that the derivatives of order DEGREE of an equation are; TERMS are lists of a series, the number of
a function and that of a monomial, MONOMIALS reach to the order of the rows."
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

(defun instances-somewhere (system place)
  "A point, and the instances there.  Points of different PLACE are random ones of different primes."
  (dotimes (attempt 200 (complain "no point was found where all coefficients exist modulo a prime"))
    (let* ((point (new-point (+ attempt (* 1000 place)) (suitable-prime (+ place (* 3 (floor attempt 10))))))
           (instances (at-point point (monomials-up-to (pde-system-variables system) 0)
                                (lambda () (chosen-instances system)))))
      (unless (eq instances :left)
        (return (values point instances))))))

;;; Completion

(defstruct completion
  "FREE: how many jets of each order are not determined.  DIMENSION: the number of solutions, nil if not known to be finite;
then all jets of order ORDER are determined.  CERTAIN: whether that number is a bound without doubt.  COUNTS: how many free
functions there are of 0, 1, .. variables."
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
  "Split the monomials in VARIABLES variables that are multiples of none of GENERATORS into cones; add to COUNTS how many
there are of each number of directions, of which DIRECTIONS are given."
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
                            (and (> (length before) order) (equal (subseq before 0 (1+ order)) (subseq free 0 (1+ order))))))
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

(defun minus-series-product (a factor b)
  (add-multiple (if (eql a 0) (constant-series 0) a) (1- *prime*) (multiply-series factor b)))

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
                                  (minus-series-product (if (and row (= (caar row) (caar other))) (cdr (pop row)) 0)
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

(defun add-level (level echelon instances system)
  (let* ((functions (pde-system-functions system))
         (monomials (monomials-up-to (pde-system-variables system) level))
         (rows (rows-at-samples instances functions)))
    (dolist (row (if (some #'cdr instances) (separated-rows rows) rows))
      (let* ((terms (loop for (column . series) in row
                          collect (list series (mod column functions) (floor column functions))))
             (order (loop for (nil nil number) in terms maximize (aref (monomials-degrees monomials) number)))
             (degree (- level order)))
        (unless (minusp degree)
          (loop for entries across (derivative-rows terms degree monomials functions)
                do (insert-row entries echelon level)))))))

(defun completed (system place known)
  "The completion of SYSTEM at a point of that PLACE; if KNOWN solutions are known, no more than that is asked."
  (multiple-value-bind (point instances) (instances-somewhere system place)
    (let ((echelon nil) (completion nil) (free '()))
      (loop for level from (pde-system-lowest system)
            for width = (* (pde-system-functions system)
                           (monomials-count (monomials-up-to (pde-system-variables system) level)))
            until completion
            do (when (> width *most-jets*)
                 (complain "the dimension of the solution space was not found with derivatives up to order ~d" (1- level)))
               (setq echelon (new-echelon width echelon))
               (at-point point
                         (monomials-up-to (pde-system-variables system) (- level (pde-system-lowest system)))
                         (lambda () (add-level level echelon instances system) t))
               (when (>= level (pde-system-highest system))
                 (multiple-value-setq (completion free) (completion-at level echelon free known system))))
      (values completion point instances))))

(defun dimension-of (system known)
  "An integer, or a vector: how many free functions there are of 0, 1, .. variables."
  (if (null (pde-system-equations system))
      (free-functions (make-list (pde-system-functions system) :initial-element '()) (pde-system-variables system))
      (let ((completion (completed system 0 known)))
        (cond ((completion-counts completion))
              ((or (completion-certain completion) (= 0 (completion-dimension completion)))
               (completion-dimension completion))
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

(maxima::defmfun maxima::$anmech_dimension (equations functions variables moving &optional (known -1))
  "anmech_dimension(equations, m, x, v, [known]): the dimension of the solution space, at least an upper bound, or
[inf, [[number of functions, of how many variables], ...]].  An equation, a list of terms [coefficient, i, [a1, .., aN]],
holds for all x and all v.  If KNOWN independent solutions are known, the answer comes as soon as there are no more."
  (let ((answer (call-with-system (lambda (system) (dimension-of system known)) equations functions variables moving)))
    (if (integerp answer)
        answer
        (maxima-list (list 'maxima::$inf
                           (maxima-list (loop for k from (1- (length answer)) downto 1
                                              when (plusp (aref answer k))
                                                collect (maxima-list (list (aref answer k) k)))))))))
