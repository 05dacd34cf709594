;;; anmech: expressions as truncated power series (series.lisp), modulo a prime, at a random point.
;;;
;;; An expression is read once into a tree of nodes.  At a point, which is a prime and a residue for every variable,
;;; parameter and transcendental kernel, a node is a Taylor polynomial in N variables, its coefficients residues.
;;;
;;; What janet.lisp concludes needs that going from expressions to residues is a homomorphism: whatever relation holds
;;; between kernels must hold between their residues.  (Residues that agree by chance do no harm.)  Relied on is this.
;;;
;;;   Roots         b^(k/q) is y^k with one y for each irreducible b.  Radicands are factored, whole powers are taken
;;;                 out. Points where b has no q-th root are left.  The primes are such that %i, sqrt(2), sqrt(3) ..
;;;                 are there.
;;;   Units         exp(%i*%pi*r), r rational, and so cos(%pi/8), is a root of unity; the primes have those that occur.
;;;                 The square roots of primes are the sums of them that they are (Gauss).
;;;   Exponentials  sin, cosh, tan ... are exponentials.  All exponents of a system are brought to one denominator D and
;;;                 expanded to sums of r*m/D, m being monomials and r rational.  Each m/D has a residue of its own for
;;;                 exp(m/(D*l)), l the common denominator of the r.  Distinct monomials are independent over Q, hence
;;;                 so are their exponentials over the rational functions (Ax 1971, the functional form of Schanuel's
;;;                 conjecture). Rational multiples of logarithms are taken out of exponents as powers; x^n is
;;;                 exp(n*log(x)).
;;;   Logarithms    log(b) is a sum over the irreducible factors of b.  Inverse functions are logarithms, and then the
;;;                 factors are those over the Gaussian numbers, the same up to units.
;;;   Functions     that are not known: a residue for each name, derivative, and residues of arguments.
;;;   Solutions     of u'' = q u (linear_solutions.lisp): residues for u_1, u_2, u_1' at the point; the Wronskian gives
;;;                 u_2', and the equation all the rest.
;;;   Sums          over the roots of p (rootsums.lisp): e(n) = lsum(r^n exp(r*u), r, rootsof(p)) are combinations of
;;;                 e(0) .. e(d-1), d the degree, with a residue each.  Between the products of these there may be
;;;                 relations (exp(r1) exp(r2) = 1 for r2 = -r1), so they may only occur linearly: where coefficients of
;;;                 equations hold them there is no series.
;;;   Numbers       %pi, log(2), %e ... count as algebraically independent.  Of one of them that is proved, and of the
;;;                 exponentials of algebraic numbers (Lindemann, Weierstrass); where there are more, it is a part of
;;;                 Schanuel's conjecture, and no bound counts as proved (doubtful-numbers-p).
;;;
;;; Not seen are relations between logarithms or roots of sums that factor only over extensions with other roots, such
;;; as x-y = (sqrt(x)-sqrt(y))*(sqrt(x)+sqrt(y)) under a root: where a root or a logarithm is taken of what holds roots,
;;; no bound counts as proved (nested-bases-p).  The root of a square is one of its two branches, and so are sqrt(x),
;;; sqrt(y), sqrt(x*y) together: where roots depend on each other up to a branch, no bound counts as proved either
;;; (undecided-branches-p).
;;;
;;; Entry points: COEFFICIENT-NODE, SETTLE-EXPONENTIALS, CALL-WITH-READER, SERIES-OF, VISIT-FIXED-PART, AT-POINT,
;;; AT-SAMPLE; *READER*, NUMBER-FORM, READER-NODES.
;;;
;;; Literature: J. Ax, On Schanuel's conjectures, Ann. Math. 93 (1971) 252.

(in-package :anmech)
(needs "session/scope" "session/texts" "arithmetic/residues" "arithmetic/series" "algebra/constants"
       "algebra/linear_solutions" "algebra/rootsums" "algebra/terms" "algebra/zero_test")

;;; Nodes.  While the coefficients of a system are read, a reader knows which of them there are.

(defstruct node
  "KIND tells what PARTS, nodes, and DATA mean.  MOVING: whether it depends on what changes from sample to sample.
SERIES is its value at the point and sample of number STAMP."
  kind parts data moving series (stamp -1 :type fixnum))

(defstruct reader
  "VARIABLES: list of the variables of series; MOVING: of those that are sampled.  NODES: forms read, by plain key.
BASES: what roots and logarithms are taken of.  EXPONENTIALS: the nodes that await SETTLE-EXPONENTIALS.
GAUSSIAN: whether factors are those over the Gaussian numbers.  RADICANDS: an alist from what roots were taken of to
their orders.  LOGARITHMS: the numbers of which there were logarithms.  EXPONENTS: those of constant exponentials."
  variables moving (nodes (make-hash-table :test #'equal)) (bases '()) (exponentials '()) gaussian
  (radicands '()) (logarithms '()) (exponents '()))

(defvar *reader* nil)

(defun call-with-reader (variables moving forms thunk)
  "THUNK with a reader for FORMS."
  (let ((*unit-order* (needed-unit-order forms))
        (*reader* (make-reader :variables (mapcar #'plain-key variables)
                               :moving (mapcar #'plain-key moving)
                               :gaussian (some (lambda (form) (some-part #'inverse-function-p form)) forms))))
    (funcall thunk)))

(defun new-node (kind parts &optional data)
  (make-node :kind kind :parts parts :data data :moving (and (some #'node-moving parts) t)))

(defun number-node (number) (new-node :number '() number))

(defun node-of (form)
  "The node of FORM, the same for equal forms."
  (let ((key (plain-key form)) (nodes (reader-nodes *reader*)))
    (or (gethash key nodes)
        (setf (gethash key nodes) (read-form form key)))))

(defun coefficient-node (form)
  "The node of FORM as it comes from outside."
  (node-of (plain-functions form)))

(defun read-form (form key)
  (let ((place (position key (reader-variables *reader*) :test #'equal)))
    (cond (place (new-node :variable '() place))
          ((rationalp form) (number-node form))
          ((eq form 'maxima::$%i) (new-node :imaginary '()))
          ((eq form 'maxima::$%e) (exponential-node 1))
          ((member form '(maxima::$inf maxima::$minf maxima::$infinity maxima::$und maxima::$ind nil t))
           (no-series form))
          ((or (symbolp form) (and (consp form) (member 'maxima::array (first form))))
           (let ((node (new-node :symbol '() form)))
             (setf (node-moving node) (and (member key (reader-moving *reader*) :test #'equal) t))
             node))
          ((atom form) (no-series form))
          (t (read-operation form)))))

(defun no-series (form)
  (complain "~a has no Taylor series here" (one-line form)))

(defun read-operation (form)
  (case (caar form)
    (maxima::rat (number-node (as-number form)))
    (maxima::mplus (new-node :sum (mapcar #'node-of (rest form))))
    (maxima::mtimes (new-node :product (mapcar #'node-of (rest form))))
    (maxima::mexpt (destructuring-bind (base exponent) (rest form)
                     (if (integerp exponent)
                         (new-node :power (list (node-of base)) exponent)
                         (power-node base exponent))))
    (maxima::%log (logarithm-node form))
    (t (cond ((root-sum-p form) (root-sum-node form))
             ((circular-p form) (node-of (maxima::$exponentialize form)))
             ((linear-solution-p form) (linear-solution-node form))
             (t (application-node form))))))

;;; Elementary functions in terms of exponentials, roots and logarithms

(defparameter *inverse-functions*
  (flet ((minus-i (form) (maxima::mul -1 'maxima::$%i form))
         (root (form) (power-of form '((maxima::rat maxima::simp) 1 2)))
         (logarithm (form) (maxima::simplify `((maxima::%log) ,form))))
    (labels ((arcsine (u)
               (minus-i (logarithm (maxima::add (maxima::mul 'maxima::$%i u) (root (maxima::sub 1 (power-of u 2)))))))
             (arccosine (u) (maxima::sub (maxima::div 'maxima::$%pi 2) (arcsine u)))
             (area-tangent (u)
               (maxima::div (maxima::sub (logarithm (maxima::add 1 u)) (logarithm (maxima::sub 1 u))) 2))
             (arctangent (u) (minus-i (area-tangent (maxima::mul 'maxima::$%i u))))
             (area-sine (u) (logarithm (maxima::add u (root (maxima::add (power-of u 2) 1)))))
             (area-cosine (u) (logarithm (maxima::add u (root (maxima::sub (power-of u 2) 1)))))
             (of-reciprocal (function) (lambda (u) (funcall function (maxima::div 1 u)))))
      (list (list 'maxima::%asin #'arcsine) (list 'maxima::%acsc (of-reciprocal #'arcsine))
            (list 'maxima::%acos #'arccosine) (list 'maxima::%asec (of-reciprocal #'arccosine))
            (list 'maxima::%atan #'arctangent) (list 'maxima::%acot (of-reciprocal #'arctangent))
            (list 'maxima::%asinh #'area-sine) (list 'maxima::%acsch (of-reciprocal #'area-sine))
            (list 'maxima::%acosh #'area-cosine) (list 'maxima::%asech (of-reciprocal #'area-cosine))
            (list 'maxima::%atanh #'area-tangent) (list 'maxima::%acoth (of-reciprocal #'area-tangent))
            (list 'maxima::%atan2 (lambda (y x) (arctangent (maxima::div y x))))
            (list 'maxima::$atan2 (lambda (y x) (arctangent (maxima::div y x)))))))
  "Functions, and what they are in terms of roots and logarithms.")

(defun inverse-function-p (form)
  (assoc (caar form) *inverse-functions*))

(defparameter *circular-functions*
  '(maxima::%sin maxima::%cos maxima::%tan maxima::%cot maxima::%sec maxima::%csc
    maxima::%sinh maxima::%cosh maxima::%tanh maxima::%coth maxima::%sech maxima::%csch))

(defun plain-functions (form)
  "FORM without inverse functions, floats and canonical rational forms; without circular and hyperbolic functions, too,
where roots, logarithms or exponentials are taken of them: these are to see what is a square."
  (labels ((walk (form)
             (cond ((floatp form) (maxima::$ratdisrep (maxima::$rat form)))
                   ((symbolp form) (with-plain-constants form))
                   ((atom form) form)
                   ((member (caar form) '(maxima::mrat maxima::bigfloat))
                    (walk (maxima::$ratdisrep (maxima::$rat form))))
                   ((inverse-function-p form)
                    (in-exponentials (apply (second (inverse-function-p form)) (mapcar #'walk (rest form)))))
                   ((or (eq (caar form) 'maxima::%log)
                        (and (eq (caar form) 'maxima::mexpt) (not (integerp (third form)))))
                    (in-exponentials (with-arguments form (mapcar #'walk (rest form)))))
                   (t (with-arguments form (mapcar #'walk (rest form)))))))
    (let ((maxima::$ratprint nil)) (walk (without-second-slopes form)))))

(defun circular-p (form) (member (caar form) *circular-functions*))

(defun in-exponentials (form)
  (if (some-part #'circular-p form) (maxima::$exponentialize form) form))

;;; Factors: an alist from bases and powers of %e to their multiplicities, rational numbers; a unit is a power of -1.

(defun factors-of (form)
  "The factors of FORM, each base up to units always the same, and the power of -1 between -1 and 1."
  (let ((turns 0) (factors '()))
    (loop for (factor . multiplicity) in (raw-factors-of form)
          do (cond ((eql factor -1) (incf turns multiplicity))
                   ((operator-p factor 'maxima::mexpt) (push (cons factor multiplicity) factors))
                   (t (multiple-value-bind (base quarters) (base-for factor)
                        (incf turns (* multiplicity quarters 1/2))
                        (push (cons (base-form base) multiplicity) factors)))))
    (let ((turns (- turns (* 2 (ceiling (1- turns) 2)))))
      (if (= turns 0) factors (acons -1 turns factors)))))

(defun raw-factors-of (form)
  (cond ((eql form 1) '())
        ((as-number form) (factors-of-number (as-number form)))
        ((eq form 'maxima::$%i) (list (cons -1 1/2)))
        ((atom form) (list (cons form 1)))
        (t (factors-in (if (reader-gaussian *reader*) (maxima::$gfactor form) (maxima::$factor form))))))

(defun factors-in (product)
  "The factors of a form that is a product of irreducible ones."
  (cond ((operator-p product 'maxima::mtimes) (mapcan #'factors-in (copy-list (rest product))))
        ((operator-p product 'maxima::mexpt)
         (destructuring-bind (base exponent) (rest product)
           (cond ((eq base 'maxima::$%e) (list (cons product 1)))
                 ((as-number exponent)
                  (loop for (factor . multiplicity) in (raw-factors-of base)
                        collect (cons factor (* multiplicity (as-number exponent)))))
                 (t (list (cons `((maxima::mexpt maxima::simp)
                                  maxima::$%e ,(maxima::mul exponent (maxima::simplify `((maxima::%log) ,base))))
                                1))))))
        ((or (atom product) (as-number product)) (raw-factors-of product))
        (t (list (cons product 1)))))

(defun factors-of-number (number)
  "Prime factors; of large ones the part that has none below 10000 stays whole."
  (let ((factors (if (minusp number) (list (cons -1 1)) '())))
    (flet ((divide (n sign)
             (loop for divisor from 2 below 10000
                   until (< n (* divisor divisor))
                   do (loop while (= 0 (mod n divisor))
                            do (setq n (floor n divisor))
                               (incf (cdr (or (assoc divisor factors) (first (push (cons divisor 0) factors)))) sign)))
             (unless (= n 1)
               (incf (cdr (or (assoc n factors) (first (push (cons n 0) factors)))) sign))))
      (divide (abs (numerator number)) 1)
      (divide (denominator number) -1))
    factors))

(defstruct base
  "FORM: what roots and logarithms are taken of, up to units.  ROOT: the node of its root of the order that is the
data of that node.  LOGARITHM: the node of its logarithm."
  form root logarithm)

(defun base-for (form)
  "The base for FORM, and the number k for which FORM is %i^k times it."
  (dolist (base (reader-bases *reader*))
    (dolist (quarters (if (reader-gaussian *reader*) '(0 2 1 -1) '(0 2)))
      (when (maxima::alike1 form (turned (base-form base) quarters))
        (return-from base-for (values base quarters)))))
  (let* ((parts (list (node-of form)))
         (base (make-base :form form :root (new-node :base parts 1) :logarithm (new-node :logarithm parts))))
    (push base (reader-bases *reader*))
    (values base 0)))

(defun turned (form quarters)
  "%i^QUARTERS * FORM, expanded."
  (if (= quarters 0)
      form
      (maxima::$expand (maxima::mul (maxima::power 'maxima::$%i quarters) form))))

(defun rational-power-node (form exponent)
  "FORM, one of factors, to the rational EXPONENT."
  (cond ((operator-p form 'maxima::mexpt) (exponential-node (maxima::mul (number-form exponent) (third form))))
        ((integerp exponent) (new-node :power (list (node-of form)) exponent))
        ((and (eql form -1) (unit-p exponent)) (new-node :turn '() exponent))
        (t (let ((root (base-root (base-for form))))
             (setf (node-data root) (lcm (node-data root) (denominator exponent)))
             (new-node :root (cons root (node-parts root)) exponent)))))

(defun unit-p (turns)
  "Whether exp(%i*%pi*TURNS) is one of the roots of unity that there are."
  (and turns (= 0 (mod *unit-order* (* 2 (denominator turns))))))

(defun number-form (number)
  (if (integerp number) number (list '(maxima::rat maxima::simp) (numerator number) (denominator number))))

(defun product-node (nodes)
  (if nodes (new-node :product nodes) (number-node 1)))

(defun note-radicand (form order)
  (let ((entry (assoc form (reader-radicands *reader*) :test #'maxima::alike1)))
    (if entry
        (setf (cdr entry) (lcm order (cdr entry)))
        (push (cons form order) (reader-radicands *reader*)))))

(defun power-node (base exponent)
  (cond ((eq base 'maxima::$%e) (exponential-node exponent))
        ((as-number exponent)
         (note-radicand base (denominator (as-number exponent)))
         (product-node (loop for (factor . multiplicity) in (factors-of base)
                             collect (rational-power-node factor (* multiplicity (as-number exponent))))))
        (t (exponential-node (maxima::mul exponent (maxima::simplify `((maxima::%log) ,base)))))))

;;; Logarithms

(defun with-split-logarithms (form)
  "FORM, its logarithms those of bases."
  (cond ((atom form) form)
        ((operator-p form 'maxima::%log)
         (sum-of (loop for (factor . multiplicity) in (factors-of (with-split-logarithms (second form)))
                       collect (maxima::mul (number-form multiplicity) (split-logarithm factor)))))
        (t (with-arguments form (mapcar #'with-split-logarithms (rest form))))))

(defun split-logarithm (factor)
  (cond ((eql factor -1) (maxima::mul 'maxima::$%i 'maxima::$%pi))
        ((operator-p factor 'maxima::mexpt) (with-split-logarithms (third factor)))
        (t `((maxima::%log maxima::simp) ,factor))))

(defvar *split* nil "Whether the logarithms being read are parts of one that was.")

(defun logarithm-node (form)
  (unless *split* (pushnew (second form) (reader-logarithms *reader*) :test #'maxima::alike1))
  (let ((base (find (second form) (reader-bases *reader*) :key #'base-form :test #'maxima::alike1)))
    (if base
        (base-logarithm base)
        (let ((*split* t)) (node-of (with-split-logarithms form))))))

;;; Exponentials

(defun exponential-node (exponent)
  "exp(EXPONENT); rational multiples of logarithms in it become powers."
  (let ((powers '()) (others '()))
    (dolist (term (terms-of (maxima::$expand (with-split-logarithms exponent))))
      (multiple-value-bind (number rest) (split-number term)
        (cond ((operator-p rest 'maxima::%log) (push (rational-power-node (second rest) number) powers))
              ((unit-p (turns number rest)) (push (new-node :turn '() number) powers))
              (t (push term others)))))
    (let ((rest (sum-of others)))
      (unless (eql rest 0)
        (let ((node (new-node :exponential (list (node-of rest)) rest)))
          (push node (reader-exponentials *reader*))
          (push node powers))))
    (product-node powers)))

(defun settle-exponentials ()
  "Write the exponentials that were read as powers of independent ones; the data of each become an alist from nodes of
those to rational numbers."
  (let* ((maxima::$algebraic t)
         (nodes (reader-exponentials *reader*))
         (forms (mapcar (lambda (node) (maxima::$ratsimp (node-data node))) nodes))
         (denominator (reduce (lambda (a b) (maxima::$ratsimp (maxima::div (maxima::mul a b) (maxima::$gcd a b))))
                              (remove 1 (mapcar #'maxima::$denom forms) :test #'eql) :initial-value 1))
         (known (make-hash-table :test #'equal)))
    (flet ((independent (monomial)
             (let ((key (plain-key monomial)))
               (or (gethash key known)
                   (let ((exponent (maxima::div monomial denominator)))
                     (push exponent (reader-exponents *reader*))
                     (setf (gethash key known) (new-node :independent (list (node-of exponent)) 1)))))))
      (loop for node in nodes
            for form in forms
            do (setf (node-data node)
                     (loop for term in (terms-of (maxima::$expand (maxima::$ratsimp (maxima::mul form denominator))))
                           collect (multiple-value-bind (number monomial) (split-number term)
                                     (let ((kernel (independent monomial)))
                                       (setf (node-data kernel) (lcm (node-data kernel) (denominator number)))
                                       (cons kernel number)))))))
    (setf (reader-exponentials *reader*) '())))

;;; Functions that are not known.  Their derivatives are sums of coefficients times applications, lists (name arguments
;;; orders) of derivatives of a function by its arguments.

(defun applications-of (form)
  "An alist from applications to coefficients if FORM is an undefined function or its derivative, perhaps at other
arguments."
  (cond ((atom form) '())
        ((unknown-function-p form) (list (cons (list (caar form) (rest form) (mapcar (constantly 0) (rest form))) 1)))
        ((operator-p form 'maxima::%derivative)
         (let ((applications (applications-of (second form))))
           (loop for (variable order) on (cddr form) by #'cddr
                 do (loop repeat order do (setq applications (derived-applications applications variable))))
           applications))
        ((operator-p form 'maxima::%at)
         (flet ((put-in (part) (maxima::$substitute (third form) part)))
           (loop for ((name arguments orders) . coefficient) in (applications-of (second form))
                 collect (cons (list name (mapcar #'put-in arguments) orders) (put-in coefficient)))))))

(defun derived-applications (applications variable)
  "The derivative by the product rule and the chain rule."
  (loop for ((name arguments orders) . coefficient) in applications
        for slope = (maxima::sdiff coefficient variable)
        unless (eql slope 0)
          collect (cons (list name arguments orders) slope)
        append (loop for argument in arguments
                     for place from 0
                     for rate = (maxima::sdiff argument variable)
                     unless (eql rate 0)
                       collect (cons (list name arguments (loop for order in orders
                                                                for k from 0
                                                                collect (if (= k place) (1+ order) order)))
                                     (maxima::mul coefficient rate)))))

(defun application-node (form)
  (new-node :sum (loop for ((name arguments orders) . coefficient) in (or (applications-of form) (no-series form))
                       collect (new-node :product
                                         (list (coefficient-node coefficient)
                                               (new-node :function (mapcar #'coefficient-node arguments)
                                                         (cons name orders)))))))

;;; Solutions of linear equations

(defun linear-solution-node (form)
  (multiple-value-bind (k q place here) (linear-solution-parts form)
    (new-node :linear-solution (mapcar #'coefficient-node (list q place here)) (cons (caar form) k))))

(defun linear-solution-series (node q place here)
  "Picard's iteration: u = u0 + the integral of u', u' = u0' + the integral of q u, by the variable that the place is."
  (destructuring-bind (operator . k) (node-data node)
    (flet ((at-point (name)
             (constant-series (function-residue (list name k) (list (constant-part q) (constant-part place)) '()))))
      (if (= 0 (monomials-degree *monomials*))
          (at-point operator)
          (let* ((value (at-point 'maxima::$linear_solution)) (slope (at-point 'maxima::$linear_slope))
                 (variable (second (node-parts node)))
                 (u value) (v slope))
            (unless (eq :variable (node-kind variable)) (complain "a solution of a linear equation has no series here"))
            (loop repeat (1+ (monomials-degree *monomials*))
                  do (setq v (add-multiple slope 1 (integrated-series (multiply-series here u) (node-data variable)))
                           u (add-multiple value 1 (integrated-series v (node-data variable)))))
            (if (eq operator 'maxima::$linear_solution) u v))))))

;;; Sums over roots

(defvar *root-sums-linear* nil "Whether sums over roots occur linearly in what the residues are for.")

(defun root-sum-node (form)
  (unless *root-sums-linear* (no-series form))
  (multiple-value-bind (power argument) (power-and-argument form)
    (if (null argument)
        (let ((split (split-root-sum form)))
          (if (root-sum-p split) (no-series form) (node-of split)))
        (let ((u (node-of argument))
              (modulus (mapcar #'node-of (coefficient-list (root-polynomial form) (summed-root form)))))
          (new-node :root-sum (cons u modulus)
                    (cons power (root-sum-kernels form argument u (1- (length modulus)))))))))

(defun root-sum-kernels (form argument u count)
  "The nodes of e(0), e(1) .. for the polynomial of FORM and ARGUMENT, whose node is U."
  (let ((key (list :root-sum (plain-key (fourth form)) (plain-key argument))) (nodes (reader-nodes *reader*)))
    (or (gethash key nodes)
        (setf (gethash key nodes) (loop repeat count collect (new-node :independent (list u) 1))))))

(defun root-sum-series (node u &rest modulus)
  (destructuring-bind (power . kernels) (node-data node)
    (let* ((lead (inverse-residue (constant-part (first (last modulus)))))
           (rule (mapcar (lambda (c) (mod (- (* lead (constant-part c))) *prime*)) (butlast modulus)))
           (window (mapcar (lambda (kernel) (residue-for kernel #'random-residue)) kernels))
           (factor 1))
      (flet ((advance ()
               (setq window (append (rest window) (list (mod (reduce #'+ (mapcar #'* rule window)) *prime*))))))
        (loop repeat power do (advance))
        (composed (up-to-degree (lambda (k)
                                  (when (plusp k) (advance) (setq factor (/ factor k)))
                                  (mod (* (first window) (number-residue factor)) *prime*)))
                  (without-constant u))))))

;;; Points

(defvar *sample* nil "The residues drawn for the present sample.")
(defvar *stamp* 0 "Counts points, degrees and samples.")
(defvar *point-stamp* 0)
(defvar *sample-stamp* 0)
(declaim (type fixnum *stamp* *point-stamp* *sample-stamp*))

(defun at-point (point monomials thunk)
  "THUNK with series at POINT, truncated to MONOMIALS; :left if one of them does not exist there."
  (let ((*point* point) (*monomials* monomials) (*prime* (point-prime point)) (*point-stamp* (incf *stamp*)))
    (catch 'point (funcall thunk))))

(defun at-sample (sample thunk)
  "THUNK with the residues of SAMPLE, a hash table to which new ones are added."
  (let ((*sample* sample) (*sample-stamp* (incf *stamp*)))
    (funcall thunk)))

(defun residue-for (node draw)
  "What has been drawn for NODE at this point, or sample."
  (let ((drawn (if (node-moving node) *sample* (point-residues *point*))))
    (or (gethash node drawn)
        (setf (gethash node drawn) (funcall draw)))))

;;; The series of a node

(defun series-of (node)
  (let ((stamp (if (node-moving node) *sample-stamp* *point-stamp*)))
    (if (= stamp (node-stamp node))
        (node-series node)
        (let ((series (new-series node)))
          (setf (node-stamp node) stamp
                (node-series node) series)))))

(defun new-series (node)
  (let ((parts (if (member (node-kind node) '(:base :independent)) '() (node-parts node))))
    (apply #'computed-series node (loop for part in parts
                                        unless (eq (node-kind part) :base) collect (series-of part)))))

(defun visit-fixed-part (node)
  "Evaluate what in NODE does not move, so that the point is left at once if that does not exist."
  (cond ((node-moving node) (mapc #'visit-fixed-part (node-parts node)))
        ((not (member (node-kind node) '(:base :independent))) (series-of node))))

(defun computed-series (node &rest parts)
  "The series of NODE, from those of its PARTS."
  (ecase (node-kind node)
    (:number (constant-series (number-residue (node-data node))))
    (:imaginary (constant-series (turn-residue 1/2)))
    (:turn (constant-series (turn-residue (node-data node))))
    (:symbol (constant-series (residue-for node #'random-power)))
    (:variable (variable-series node))
    (:sum (reduce (lambda (a b) (add-multiple a 1 b)) parts))
    (:product (reduce #'multiply-series parts))
    (:power (whole-power-of-series (first parts) (node-data node)))
    (:root (root-series node (first parts)))
    (:logarithm (logarithm-of-series (first parts) (residue-for node #'random-residue)))
    (:exponential (exponential-series node (first parts)))
    (:root-sum (apply #'root-sum-series node parts))
    (:linear-solution (apply #'linear-solution-series node parts))
    (:function (function-series node parts))))

(defun root-series (node series)
  "A power, its exponent the data of NODE, of SERIES; the first part of NODE stands for the root."
  (let* ((base (first (node-parts node)))
         (number (node-data (first (node-parts base))))
         (root (residue-for base (lambda ()
                                   (if (and (integerp number) (eq :number (node-kind (first (node-parts base)))))
                                       (integer-root-residue number (node-data base))
                                       (root-residue (constant-part series) (node-data base)))))))
    (power-of-series series (node-data node) (power-residue root (* (node-data node) (node-data base))))))

(defun exponential-series (node series)
  (let ((value 1))
    (loop for (kernel . number) in (node-data node)
          do (setq value (mod (* value (power-residue (residue-for kernel #'random-power)
                                                      (* number (node-data kernel))))
                              *prime*)))
    (exponential-of-series series value)))

(defun function-series (node arguments)
  "Taylor's formula for an undefined function."
  (destructuring-bind (name . orders) (node-data node)
    (let* ((values (mapcar #'constant-part arguments))
           (rests (mapcar #'without-constant arguments))
           (sum (constant-series 0)))
      (loop for exponents across (monomials-exponents (monomials-up-to (length arguments)
                                                                       (monomials-degree *monomials*)))
            do (let ((power (constant-series (function-residue name values (mapcar #'+ orders exponents)))) (divisor 1))
                 (loop for rest in rests
                       for exponent in exponents
                       do (loop for k from 1 to exponent
                                do (setq power (multiply-series power rest) divisor (* divisor k))))
                 (setq sum (add-multiple sum (number-residue (/ divisor)) power))))
      sum)))

(defun function-residue (name values orders)
  (let ((key (list name values orders)) (functions (point-functions *point*)))
    (or (gethash key functions)
        (setf (gethash key functions) (random-residue)))))

(defun variable-series (node)
  (let ((series (constant-series (residue-for node #'random-power))) (units (monomials-units *monomials*)))
    (when units (setf (aref (the residues series) (nth (node-data node) units)) 1))
    series))
