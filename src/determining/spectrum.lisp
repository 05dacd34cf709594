;;; anmech: eigenvalues of translations on the solutions of a linear homogeneous system of partial differential
;;; equations.
;;;
;;; The spectrum of d/dz, z being in no coefficient, is that of a matrix on the jets that remain free.  Its
;;; characteristic polynomial modulo primes, at random parameters, is taken apart into square-free parts, and their
;;; coefficients are interpolated as rational functions of the parameters.  It is checked at another point modulo
;;; another prime.
;;;
;;; Entry point: anmech_characteristic, with equations as for anmech_dimension (janet.lisp).
;;;
;;; Literature: H. Cohen, A Course in Computational Algebraic Number Theory (1993), 2.2.4.

(in-package :anmech)
(needs "session/outcomes" "session/texts" "arithmetic/polynomials" "arithmetic/residues" "arithmetic/series"
       "algebra/nodes" "algebra/sparse" "algebra/terms" "determining/janet")

;;; The characteristic polynomial modulo the prime

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

(defun fitted (numerator denominator points)
  "The rational function of these monomials with the values at POINTS, pairs of the parameters' values and the value;
or nil."
  (let ((echelon (new-echelon (+ (length numerator) (length denominator)))))
    (loop for (values . value) in points
          do (insert-equation (append (mapcar (lambda (exponents) (monomial-residue exponents values)) numerator)
                                      (mapcar (lambda (exponents)
                                                (mod (- (* value (monomial-residue exponents values))) *prime*))
                                              denominator))
                              echelon))
    (let ((vector (null-vector-of echelon)))
      (and vector (some #'plusp (nthcdr (length numerator) vector))
           (list numerator denominator vector)))))

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

;;; Rational functions from residues

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

(defun changed-values (given &optional (nodes (mapcar #'car given)))
  "GIVEN with other integers for NODES."
  (loop for (node . root) in given collect (cons node (if (member node nodes) (+ root 1) root))))

(defun relevant-parameters (system direction known given first)
  "The parameters in GIVEN with which the spectrum changes, which is FIRST for their values there.  Most often there are
none, which one completion tells."
  (flet ((changes-p (values)
           (let ((other (spectrum-at system direction 0 known values)))
             (not (and (= (spectrum-prime other) (spectrum-prime first))
                       (equal (spectrum-coefficients other) (spectrum-coefficients first)))))))
    (and given
         (changes-p (changed-values given))
         (loop for (node) in given
               when (changes-p (changed-values given (list node))) collect node))))

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

(defun spectral-functions (system direction known)
  "Pattern of the spectrum, rational functions for all coefficients, and their parameters; nil if they were not found."
  (let* ((parameters (given-values (parameter-nodes) 0))
         (dimension (or known (dimension-of system -1)))
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

(maxima::defmfun maxima::$anmech_characteristic (equations functions variables moving direction eigenvalue
                                                  &optional known)
  "anmech_characteristic(equations, m, x, v, z, lambda, [dimension]): the characteristic polynomial in lambda, as a
product of powers of square-free ones, of the derivative by z on the space of solutions, whose dimension may be given; z
is one of x that is in no coefficient.
Not found if there are infinitely many solutions, if the coefficients are no rational functions of the parameters, or
if they are of a degree that needs more than some hundred values of the parameters."
  (let ((place (position direction (rest variables) :test #'maxima::alike1)))
    (unless (and place (maxima::$freeof direction (maxima-list (rest equations))))
      (complain "~a must be one of the variables, and in no coefficient" (one-line direction)))
    (let ((found (call-with-system (lambda (system) (spectral-functions system place known))
                                   equations functions variables moving)))
      (if (null found)
          (maxima::$anmech_not_found 'maxima::$spectrum)
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
