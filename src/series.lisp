;;; anmech: expressions as truncated power series, modulo a prime, at a random point.
;;;
;;; An expression is read once into a tree of nodes.  At a point, which is a prime and a residue for every variable,
;;; parameter and transcendental kernel, a node is a Taylor polynomial in N variables, its coefficients residues; monomials
;;; are numbered by their total degree, so a polynomial of lower degree is the beginning of one of higher degree.
;;;
;;; What janet.lisp concludes needs that going from expressions to residues is a homomorphism: whatever relation holds
;;; between kernels must hold between their residues.  (Residues that agree by chance do no harm.)  Relied on is this.
;;;
;;;   Roots         b^(k/q) is y^k with one y for each irreducible b.  Radicands are factored, whole powers are taken out.
;;;                 Points where b has no q-th root are left.  A primitive fourth root of 1 is there: p = 5 modulo 8.
;;;   Exponentials  sin, cosh, tan ... are exponentials.  All exponents of a system are brought to one denominator D and
;;;                 expanded to sums of r*m/D, m being monomials and r rational.  Each m/D has a residue of its own for
;;;                 exp(m/(D*l)), l the common denominator of the r.  Distinct monomials are independent over Q, hence so are
;;;                 their exponentials over the rational functions (Ax 1971, the functional form of Schanuel's conjecture).
;;;                 Rational multiples of logarithms are taken out of exponents as powers; x^n is exp(n*log(x)).
;;;   Logarithms    log(b) is a sum over the irreducible factors of b.  Inverse functions are logarithms, and then the factors
;;;                 are those over the Gaussian numbers, the same up to units.
;;;   Functions     that are not known: a residue for each name, derivative, and residues of arguments.
;;;   Numbers       %pi, log(2), %e ... count as algebraically independent (a part of Schanuel's conjecture).
;;;
;;; Not seen are relations between logarithms or roots of sums that factor only over extensions with other roots, such as
;;; x-y = (sqrt(x)-sqrt(y))*(sqrt(x)+sqrt(y)) under a root.
;;;
;;; Entry points: NODE-OF, SETTLE-EXPONENTIALS, CALL-WITH-READER, SERIES-OF, AT-POINT, AT-SAMPLE, MONOMIALS-UP-TO.
;;;
;;; Literature: D. E. Knuth, The Art of Computer Programming 2, 4.7; A. Griewank, A. Walther, Evaluating Derivatives (2008),
;;; chapter 13; J. Ax, On Schanuel's conjectures, Ann. Math. 93 (1971) 252.

(in-package :anmech)

;;; Residues.  Primes are below 2^30, so that a product and a sum are fixnums on every Lisp.

(deftype residues () '(simple-array fixnum (*)))

(defvar *primes* '() "The primes found so far, the smallest first.")

(defun suitable-prime-p (n)
  "Whether N is a prime, 5 modulo 8, for which 3, 5, 7, 11 and 13 do not divide N - 1: then roots are few and easy."
  (declare (fixnum n))
  (and (= 5 (mod n 8))
       (= 1 (gcd (1- n) 15015))
       (do ((divisor 3 (+ divisor 2)))
           ((> (* divisor divisor) n) t)
         (declare (fixnum divisor))
         (when (= 0 (the fixnum (rem n divisor))) (return nil)))))

(defun suitable-prime (place)
  "The prime of that PLACE, from 0 on."
  (loop while (<= (length *primes*) place)
        do (push (loop for n from (1- (if *primes* (first *primes*) (expt 2 30))) downto 3
                       when (suitable-prime-p n) return n)
                 *primes*))
  (nth (- (length *primes*) 1 place) *primes*))

(defvar *prime* 1073741717)
(declaim (type fixnum *prime*))

(defmacro plus-product (a factor b prime)
  "A + FACTOR * B modulo PRIME, all of them fixnums."
  `(the fixnum (rem (the fixnum (+ (the fixnum ,a) (the fixnum (* (the fixnum ,factor) (the fixnum ,b)))))
                    (the fixnum ,prime))))

(defun leave-point ()
  "What is asked for does not exist at this point: another one is to be tried."
  (throw 'point :left))

(defun inverse-modulo (a modulus)
  "1/A modulo MODULUS, or nil if there is none."
  (let ((b modulus) (u 1) (v 0) (a (mod a modulus)))
    (loop until (= a 0)
          do (let ((quotient (floor b a)))
               (psetq a (- b (* quotient a)) b a
                      u (- v (* quotient u)) v u)))
    (and (= b 1) (mod v modulus))))

(defun inverse-residue (a)
  (or (inverse-modulo a *prime*) (leave-point)))

(defun power-residue (a exponent)
  (if (minusp exponent)
      (power-residue (inverse-residue a) (- exponent))
      (let ((result 1))
        (loop until (= exponent 0)
              do (when (oddp exponent) (setq result (mod (* result a) *prime*)))
                 (setq a (mod (* a a) *prime*) exponent (ash exponent -1)))
        result)))

(defun number-residue (number)
  (if (integerp number)
      (mod number *prime*)
      (mod (* (numerator number) (inverse-residue (denominator number))) *prime*)))

(defun imaginary-residue ()
  (power-residue 2 (floor *prime* 4)))

(defun root-residue (a order)
  "A root of A; it is in the subgroup of odd order wherever A is there."
  (let* ((odd (floor *prime* 4))                      ; the group of residues has 4 * odd elements
         (inverse (or (inverse-modulo order odd) (complain "roots of order ~d are not supported" order)))
         (sign (power-residue a odd)))
    (cond ((= sign 1) (power-residue a inverse))
          ((oddp order) (power-residue a (inverse-modulo order (* 4 odd))))
          ((and (= sign (1- *prime*)) (= 2 (mod order 4)))
           (mod (* (imaginary-residue) (power-residue (- *prime* a) inverse)) *prime*))
          (t (leave-point)))))

;;; Monomials in N variables, numbered by degree

(defstruct monomials
  "All monomials up to DEGREE.  ENDS: how many there are up to each degree.  EXPONENTS: their lists.  DEGREES: their degrees.
PRODUCTS: for each one its products with those for which the product is here.  UNITS: the numbers of the variables."
  degree (ends nil :type residues) (exponents nil :type simple-vector) (degrees nil :type residues)
  (products nil :type simple-vector) units)

(defvar *known-monomials* (make-hash-table :test #'equal))

(defun exponents-of-degree (count degree)
  "All lists of COUNT numbers with the sum DEGREE."
  (if (= count 1)
      (list (list degree))
      (loop for first from 0 to degree
            nconc (mapcar (lambda (others) (cons first others))
                          (exponents-of-degree (1- count) (- degree first))))))

(defun fixnums (list)
  (make-array (length list) :element-type 'fixnum :initial-contents list))

(defun exponents-code (exponents)
  (let ((code 0))
    (dolist (exponent exponents code) (setq code (+ exponent (* 64 code))))))

(defun new-monomials (count degree)
  (let* ((by-degree (loop for d from 0 to degree collect (exponents-of-degree count d)))
         (ends (fixnums (loop for list in by-degree sum (length list) into end collect end)))
         (exponents (coerce (apply #'append by-degree) 'simple-vector))
         (codes (map 'simple-vector #'exponents-code exponents))
         (degrees (map 'list (lambda (list) (reduce #'+ list)) exponents))
         (numbers (make-hash-table :test #'eql)))
    (dotimes (k (length codes)) (setf (gethash (svref codes k) numbers) k))
    (make-monomials
     :degree degree :ends ends :exponents exponents :degrees (fixnums degrees)
     :products (coerce (loop for d in degrees
                             for code across codes
                             collect (fixnums (loop for k below (aref ends (- degree d))
                                                    collect (gethash (+ code (svref codes k)) numbers))))
                       'simple-vector)
     :units (and (plusp degree)
                 (loop for k below count collect (gethash (expt 64 (- count 1 k)) numbers))))))

(defun monomials-up-to (count degree)
  (let ((key (cons count degree)))
    (or (gethash key *known-monomials*)
        (setf (gethash key *known-monomials*) (new-monomials count degree)))))

(defun monomials-count (monomials)
  (length (monomials-exponents monomials)))

;;; Series: arrays of residues, one for each of *MONOMIALS*; they are never changed.

(defvar *monomials* nil "The monomials of the series that are computed with at present.")

(declaim (ftype (function (t t t) t) add-multiple series-product))

(defun constant-series (residue)
  (let ((series (make-array (monomials-count *monomials*) :element-type 'fixnum :initial-element 0)))
    (setf (aref series 0) residue)
    series))

(defun constant-part (series) (aref (the residues series) 0))

(defun add-multiple (a factor b)
  "A + FACTOR * B."
  (declare (type residues a b) (fixnum factor))
  (with-fast-arithmetic
    (let ((sum (make-array (length a) :element-type 'fixnum)) (prime *prime*))
      (declare (type residues sum) (fixnum prime))
      (for (k (length a))
        (setf (aref sum k) (plus-product (aref a k) factor (aref b k) prime)))
      sum)))

(defun series-product (a b products)
  (declare (type residues a b) (type simple-vector products))
  (with-fast-arithmetic
    (let ((result (make-array (length a) :element-type 'fixnum :initial-element 0)) (prime *prime*))
      (declare (type residues result) (fixnum prime))
      (for (i (length a))
        (let ((factor (aref a i)) (places (svref products i)))
          (declare (fixnum factor) (type residues places))
          (unless (= 0 factor)
            (for (j (length places))
              (let ((other (aref b j)) (place (aref places j)))
                (declare (fixnum other place))
                (unless (= 0 other)
                  (setf (aref result place)
                        (plus-product (aref result place) factor other prime))))))))
      result)))

(defun multiply-series (a b)
  (series-product a b (monomials-products *monomials*)))

(defun scaled-series (series factor)
  (add-multiple (constant-series 0) factor series))

(defun zero-series-p (series)
  (every #'zerop (the residues series)))

(defun without-constant (series)
  (let ((rest (copy-seq (the residues series))))
    (setf (aref rest 0) 0)
    rest))

(defun composed (coefficients rest)
  "The sum of COEFFICIENTS, a list of residues, times powers of REST, a series without constant part, by Horner's rule."
  (let* ((reversed (reverse coefficients)) (result (constant-series (first reversed))))
    (dolist (coefficient (rest reversed) result)
      (setq result (copy-seq (the residues (multiply-series result rest))))
      (setf (aref result 0) coefficient))))

(defun up-to-degree (next)
  "The list of (funcall NEXT k), k from 0 to the present degree."
  (loop for k from 0 to (monomials-degree *monomials*) collect (funcall next k)))

(defun relative-rest (series)
  "SERIES / its constant part - 1."
  (without-constant (scaled-series series (inverse-residue (constant-part series)))))

(defun power-of-series (series exponent &optional (value (power-residue (constant-part series) exponent)))
  "SERIES to the rational EXPONENT, VALUE being the constant part of it."
  (let ((binomial 1))
    (scaled-series
     (composed (up-to-degree (lambda (k)
                               (prog1 (number-residue binomial)
                                 (setq binomial (/ (* binomial (- exponent k)) (1+ k))))))
               (relative-rest series))
     value)))

(defun whole-power-of-series (series exponent)
  (if (minusp exponent)
      (power-of-series series exponent)
      (let ((result (constant-series 1)))
        (loop until (= exponent 0)
              do (when (oddp exponent) (setq result (multiply-series result series)))
                 (setq exponent (ash exponent -1))
                 (unless (= exponent 0) (setq series (multiply-series series series))))
        result)))

(defun exponential-of-series (series value)
  "exp(SERIES), VALUE being the constant part of it."
  (let ((factor 1))
    (scaled-series
     (composed (up-to-degree (lambda (k) (when (plusp k) (setq factor (/ factor k))) (number-residue factor)))
               (without-constant series))
     value)))

(defun logarithm-of-series (series value)
  (composed (up-to-degree (lambda (k) (if (= k 0) value (number-residue (/ (if (oddp k) 1 -1) k)))))
            (relative-rest series)))

;;; Nodes.  While the coefficients of a system are read, a reader knows which of them there are.

(defstruct node
  "KIND tells what PARTS, nodes, and DATA mean.  MOVING: whether it depends on what changes from sample to sample.
SERIES is its value at the point and sample of number STAMP."
  kind parts data moving series (stamp -1 :type fixnum))

(defstruct reader
  "VARIABLES: list of the variables of series; MOVING: of those that are sampled.  NODES: forms read, by plain key.
BASES: what roots and logarithms are taken of: lists of (node form order), the order being that of the roots needed.
EXPONENTIALS: the nodes that await SETTLE-EXPONENTIALS.  GAUSSIAN: whether factors are those over Gaussian numbers."
  variables moving (nodes (make-hash-table :test #'equal)) (bases '()) (exponentials '()) gaussian)

(defvar *reader* nil)

(defun call-with-reader (variables moving thunk)
  (let ((*reader* (make-reader :variables (mapcar #'plain-key variables) :moving (mapcar #'plain-key moving))))
    (funcall thunk)))

(defun new-node (kind parts &optional data)
  (make-node :kind kind :parts parts :data data :moving (and (some #'node-moving parts) t)))

(defun number-node (number) (new-node :number '() number))

(defun node-of (form)
  "The node of FORM, the same for equal forms."
  (let ((key (plain-key form)) (nodes (reader-nodes *reader*)))
    (or (gethash key nodes)
        (setf (gethash key nodes) (read-form form key)))))

(defun read-form (form key)
  (let ((place (position key (reader-variables *reader*) :test #'equal)))
    (cond (place (new-node :variable '() place))
          ((rationalp form) (number-node form))
          ((eq form 'maxima::$%i) (new-node :imaginary '()))
          ((eq form 'maxima::$%e) (exponential-node 1))
          ((or (numberp form) (operator-p form 'maxima::bigfloat))
           (node-of (maxima::$ratdisrep (maxima::$rat form))))
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
    (maxima::mrat (node-of (maxima::$ratdisrep form)))
    (maxima::mplus (new-node :sum (mapcar #'node-of (rest form))))
    (maxima::mtimes (new-node :product (mapcar #'node-of (rest form))))
    (maxima::mexpt (if (integerp (third form))
                       (new-node :power (list (node-of (second form))) (third form))
                       (no-series form)))
    (t (no-series form))))

(defun as-number (form)
  "The rational number that FORM is, or nil."
  (cond ((rationalp form) form)
        ((operator-p form 'maxima::rat) (/ (second form) (third form)))))

;;; Points

(defstruct point
  "A PRIME, and the residues of nodes that have been drawn so far; STATE is that of the random numbers."
  prime state (residues (make-hash-table :test #'eq)) (functions (make-hash-table :test #'equal)))

(defvar *point* nil)
(defvar *sample* nil "The residues drawn for the present sample.")
(defvar *stamp* 0 "Counts points, degrees and samples.")
(defvar *point-stamp* 0)
(defvar *sample-stamp* 0)
(declaim (type fixnum *stamp* *point-stamp* *sample-stamp*))

(defun new-point (seed prime)
  (make-point :prime prime :state (+ 88172645463325252 (* 7919 seed))))

(defun at-point (point monomials thunk)
  "THUNK with series at POINT, truncated to MONOMIALS; :left if one of them does not exist there."
  (let ((*point* point) (*monomials* monomials) (*prime* (point-prime point)) (*point-stamp* (incf *stamp*)))
    (catch 'point (funcall thunk))))

(defun at-sample (sample thunk)
  "THUNK with the residues of SAMPLE, a hash table to which new ones are added."
  (let ((*sample* sample) (*sample-stamp* (incf *stamp*)))
    (funcall thunk)))

(defun random-residue ()
  (setf (point-state *point*) (mod (+ 11 (* 25214903917 (point-state *point*))) 281474976710656))
  (1+ (mod (ash (point-state *point*) -10) (1- *prime*))))

(defun random-power ()
  "A fourth power, of which there are roots."
  (power-residue (random-residue) 4))

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
  (let ((parts (mapcar #'series-of (node-parts node))))
    (ecase (node-kind node)
      (:number (constant-series (number-residue (node-data node))))
      (:imaginary (constant-series (imaginary-residue)))
      (:symbol (constant-series (residue-for node #'random-power)))
      (:variable (variable-series node))
      (:sum (reduce (lambda (a b) (add-multiple a 1 b)) parts))
      (:product (reduce #'multiply-series parts))
      (:power (whole-power-of-series (first parts) (node-data node))))))

(defun variable-series (node)
  (let ((series (constant-series (residue-for node #'random-power))) (units (monomials-units *monomials*)))
    (when units (setf (aref (the residues series) (nth (node-data node) units)) 1))
    series))

(defun settle-exponentials ())
(defun exponential-node (form) (no-series form))
