;;; anmech: collocation methods: their nodes and what belongs to these, computed once with sixty digits.
;;;
;;; A *rule* of s stages has nodes c in (0, 1], the matrix A of the integrals over [0, c_i] of the polynomials that are
;;; 1 at one node, weights, and the matrix D with  h f(c_i) = sum D_ij (y(c_j) - y(0)), the inverse of A.  Of the nodes'
;;; polynomial M all else follows: an eigenvalue g of D is a zero of  sum_k M^(k)(0) g^(s - k), its eigenvector the
;;; values at the nodes of the polynomial  sum_k M^(k)(x) g^(-k - 1).
;;;
;;; Entry points: the structure RULE; LEGENDRE-POLYNOMIAL, ROOTS-IN-UNIT-INTERVAL, NEW-RULE, BASIS-POLYNOMIAL,
;;; EXACT-VALUE-AT, DOUBLES-OF; the structure EIGENSYSTEM; RULE-EIGENSYSTEM.
;;;
;;; Literature: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, IV.5 and IV.8.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/dag")

(defparameter *bits* 220 "Of the numbers that rules are computed with.")

(defun cut-off (number)
  "NUMBER, rational or complex, rounded to *BITS* behind the point."
  (if (complexp number)
      (complex (cut-off (realpart number)) (cut-off (imagpart number)))
      (/ (round (* number (ash 1 *bits*))) (ash 1 *bits*))))

;;; Polynomials: lists of coefficients, the constant first

(defun exact-value-at (polynomial x)
  (let ((value 0))
    (dolist (coefficient (reverse polynomial) value)
      (setq value (cut-off (+ coefficient (* x value)))))))

(defun derivative-of-polynomial (polynomial)
  (loop for coefficient in (rest polynomial) for k from 1 collect (* k coefficient)))

(defun integral-of-polynomial (polynomial)
  (cons 0 (loop for coefficient in polynomial for k from 1 collect (/ coefficient k))))

(defun polynomial-of-roots (roots)
  (let ((product '(1)))
    (dolist (root roots product)
      (setq product (mapcar #'cut-off (mapcar #'- (cons 0 product)
                                                (mapcar (lambda (c) (* root c)) (append product '(0)))))))))

(defun legendre-polynomial (s)
  "That of degree S on [0, 1], with rational coefficients."
  (loop for k from 0 to s
        collect (* (if (evenp (- s k)) 1 -1) (choose s k) (choose (+ s k) k))))

(defun choose (n k) (let ((product 1)) (dotimes (i k product) (setq product (/ (* product (- n i)) (1+ i))))))

(defun roots-in-unit-interval (polynomial)
  "Those of one that has as many simple roots in (0, 1] as its degree says, in order."
  (let ((parts 400))
    (loop for k from 1 to parts
          for low = (/ (1- k) parts)
          for high = (/ k parts)
          for below = (exact-value-at polynomial low)
          for above = (exact-value-at polynomial high)
          when (zerop above) collect high
          else when (and (minusp (* below above))) collect (root-between polynomial low high))))

(defun root-between (polynomial low high)
  (let ((sign (signum (exact-value-at polynomial low))))
    (loop repeat 12
          for middle = (/ (+ low high) 2)
          do (if (= sign (signum (exact-value-at polynomial middle))) (setq low middle) (setq high middle)))
    (refined-root polynomial (/ (+ low high) 2))))

(defun refined-root (polynomial x)
  "By Newton's method, each step of which doubles the digits; X may be complex."
  (let ((slope (derivative-of-polynomial polynomial)))
    (loop repeat 8 do (setq x (cut-off (- x (/ (exact-value-at polynomial x) (exact-value-at slope x))))))
    x))

;;; Rules

(defstruct rule
  nodes               ; rationals, of many digits; all others are doubles, matrices by rows
  (c nil :type double-array)
  (a nil :type double-array)
  (b nil :type double-array)
  (d nil :type double-array)
  (behind nil :type double-array))     ; with h f(c_i) they give the h f at 0 that their polynomial has there

(defun basis-polynomial (nodes node)
  "The one that is 1 at NODE and 0 at the others."
  (let* ((others (remove node nodes)) (product (polynomial-of-roots others)) (value (exact-value-at product node)))
    (mapcar (lambda (c) (cut-off (/ c value))) product)))

(defun doubles-of (numbers) (map 'double-array #'to-double numbers))

(defun new-rule (nodes)
  (let* ((basis (mapcar (lambda (node) (basis-polynomial nodes node)) nodes))
         (integrals (mapcar #'integral-of-polynomial basis))
         (with-zero (mapcar (lambda (node) (derivative-of-polynomial (basis-polynomial (cons 0 nodes) node))) nodes)))
    (flet ((table (polynomials)
             (doubles-of (loop for node in nodes
                               append (mapcar (lambda (polynomial) (exact-value-at polynomial node)) polynomials)))))
      (make-rule :nodes nodes :c (doubles-of nodes) :a (table integrals) :d (table with-zero)
                 :b (doubles-of (mapcar (lambda (integral) (exact-value-at integral 1)) integrals))
                 :behind (doubles-of (mapcar (lambda (polynomial) (exact-value-at polynomial 0)) basis))))))

;;; Eigenvalues

(defstruct eigensystem
  "Of D of a rule with an odd number of stages: the real eigenvalue, those of positive imaginary part as two arrays; the
columns of TO-STAGES are the eigenvectors, of a complex one u + i w first u, then w; FROM-STAGES is its inverse."
  (value 0d0 :type double-float)
  (real nil :type double-array)
  (imaginary nil :type double-array)
  (to-stages nil :type double-array)
  (from-stages nil :type double-array))

(defun derivatives-of-polynomial (polynomial)
  "All of them, itself first."
  (loop while polynomial
        collect polynomial
        do (setq polynomial (derivative-of-polynomial polynomial))))

(defun complex-roots (polynomial)
  "Of one with real coefficients: doubles, by the simultaneous iteration of Durand and Kerner."
  (let* ((degree (1- (length polynomial))) (leading (first (last polynomial)))
         (monic (mapcar (lambda (c) (to-double (/ c leading))) polynomial))
         (size (reduce #'max (loop for c in monic for k from 0 below degree
                                   collect (expt (abs c) (/ 1d0 (- degree k))))))
         (roots (loop for k below degree collect (* size (expt #c(0.4d0 0.9d0) k)))))
    (flet ((value (x) (let ((sum 0)) (dolist (c (reverse monic) sum) (setq sum (+ c (* x sum)))))))
      (loop repeat 200
            do (setq roots (loop for root in roots
                                 for k from 0
                                 collect (- root (/ (value root)
                                                    (let ((product 1))
                                                      (loop for other in roots for j from 0
                                                            unless (= j k) do (setq product (* product (- root other))))
                                                      product))))))
      roots)))

(defun exact-complex (number) (complex (rational (realpart number)) (rational (imagpart number))))

(defun rule-eigensystem (rule)
  (let* ((nodes (rule-nodes rule)) (derivatives (derivatives-of-polynomial (polynomial-of-roots nodes)))
         (polynomial (reverse (mapcar (lambda (derivative) (exact-value-at derivative 0)) derivatives)))
         (roots (complex-roots polynomial))
         (real (refined-root polynomial (rational (realpart (first (sort (copy-list roots) #'<
                                                                         :key (lambda (z) (abs (imagpart z)))))))))
         (complex (mapcar (lambda (root) (refined-root polynomial (exact-complex root)))
                          (sort (remove-if-not (lambda (z) (> (imagpart z) (* 1d-6 (abs z)))) roots)
                                #'< :key #'imagpart)))
         (columns (cons (eigenvector derivatives nodes real)
                        (loop for value in complex
                              for vector = (eigenvector derivatives nodes value)
                              collect (mapcar #'realpart vector)
                              collect (mapcar #'imagpart vector))))
         (to-stages (apply #'mapcar #'list columns)))
    (make-eigensystem :value (to-double real)
                      :real (doubles-of (mapcar #'realpart complex))
                      :imaginary (doubles-of (mapcar #'imagpart complex))
                      :to-stages (doubles-of (apply #'append to-stages))
                      :from-stages (doubles-of (apply #'append (inverse-of-rows to-stages))))))

(defun eigenvector (derivatives nodes value)
  "Scaled so that its largest entry has size 1."
  (let* ((vector (loop for node in nodes
                       collect (let ((sum 0) (power (cut-off (/ value))))
                                 (dolist (derivative derivatives sum)
                                   (setq sum (cut-off (+ sum (* power (exact-value-at derivative node))))
                                         power (cut-off (/ power value)))))))
         (largest (reduce (lambda (x y) (if (> (square-size x) (square-size y)) x y)) vector)))
    (mapcar (lambda (x) (cut-off (/ x largest))) vector)))

(defun square-size (z) (+ (expt (realpart z) 2) (expt (imagpart z) 2)))

(defun inverse-of-rows (rows)
  "The inverse of a matrix of rationals, rounded on the way."
  (let* ((n (length rows))
         (work (coerce (loop for row in rows for i from 0
                             collect (coerce (append row (loop for j below n collect (if (= i j) 1 0))) 'vector))
                       'vector)))
    (dotimes (k n)
      (let ((best (loop with best = k for i from k below n
                        do (when (> (abs (aref (aref work i) k)) (abs (aref (aref work best) k))) (setq best i))
                        finally (return best))))
        (rotatef (aref work k) (aref work best)))
      (let ((pivot (aref (aref work k) k)))
        (map-into (aref work k) (lambda (x) (cut-off (/ x pivot))) (aref work k)))
      (dotimes (i n)
        (unless (= i k)
          (let ((factor (aref (aref work i) k)))
            (map-into (aref work i) (lambda (x y) (cut-off (- x (* factor y)))) (aref work i) (aref work k))))))
    (loop for row across work collect (coerce (subseq row n) 'list))))
