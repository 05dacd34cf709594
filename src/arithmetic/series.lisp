;;; anmech: truncated power series in N variables modulo a prime.
;;;
;;; A series is an array of residues, one for each of *MONOMIALS*, which are numbered by their total degree: a
;;; polynomial of lower degree is the beginning of one of higher degree.  Series are never changed.
;;;
;;; Entry points: MONOMIALS and MONOMIALS-UP-TO; CONSTANT-SERIES, CONSTANT-PART, WITHOUT-CONSTANT, UP-TO-DEGREE,
;;; ZERO-SERIES-P, ADD-MULTIPLE, MULTIPLY-SERIES, MINUS-SERIES-PRODUCT, POWER-OF-SERIES, WHOLE-POWER-OF-SERIES,
;;; EXPONENTIAL-OF-SERIES, LOGARITHM-OF-SERIES, INTEGRATED-SERIES, COMPOSED; the type FIXNUMS.
;;;
;;; Literature: D. E. Knuth, The Art of Computer Programming 2, 4.7; A. Griewank, A. Walther, Evaluating Derivatives
;;; (2008), chapter 13.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/residues")

;;; Monomials in N variables, numbered by degree

(defstruct monomials
  "All monomials up to DEGREE.  ENDS: how many there are up to each degree.  EXPONENTS: their lists.  DEGREES: their
degrees. PRODUCTS: for each one its products with those for which the product is here.  UNITS: the numbers of the
variables."
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

;;; Series

(defvar *monomials* nil "The monomials of the series that are computed with at present.")

(declaim (ftype (function (t fixnum t) t) add-multiple)
         (ftype (function (t fixnum t t t) t) accumulate-product))

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

(defun accumulate-product (result sign a b products)
  "Change RESULT by SIGN, 1 or -1, times A * B."
  (declare (type residues result a b) (fixnum sign) (type simple-vector products))
  (with-fast-arithmetic
    (let ((prime *prime*))
      (declare (fixnum prime))
      (for (i (length a))
        (let ((entry (aref a i)) (places (svref products i)))
          (declare (fixnum entry) (type residues places))
          (unless (= 0 entry)
            (let ((factor (if (= sign 1) entry (fix (- prime entry)))))
              (declare (fixnum factor))
              (for (j (length places))
                (let ((other (aref b j)) (place (aref places j)))
                  (declare (fixnum other place))
                  (unless (= 0 other)
                    (setf (aref result place) (plus-product (aref result place) factor other prime)))))))))
      result)))

(defun multiply-series (a b)
  (accumulate-product (constant-series 0) 1 a b (monomials-products *monomials*)))

(defun minus-series-product (a b c)
  "A - B * C."
  (accumulate-product (copy-seq (the residues a)) -1 b c (monomials-products *monomials*)))

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

(defun integrated-series (series variable)
  "The antiderivative without constant part of SERIES, by the VARIABLE of that number; the highest terms are lost."
  (let* ((result (copy-seq (the residues (constant-series 0))))
         (places (svref (monomials-products *monomials*) (nth variable (monomials-units *monomials*)))))
    (dotimes (k (length places) result)
      (unless (= 0 (aref (the residues series) k))
        (setf (aref result (aref places k))
              (mod (* (aref series k)
                      (number-residue (/ (1+ (nth variable (svref (monomials-exponents *monomials*) k))))))
                   *prime*))))))
