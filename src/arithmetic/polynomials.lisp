;;; anmech: polynomials in one variable, modulo a prime: lists of residues, the constant one first, the last one not
;;; zero.
;;;
;;; Entry points: TRIMMED-POLYNOMIAL, COMBINED-POLYNOMIALS, POLYNOMIAL-PRODUCT, DIVIDED-POLYNOMIAL, COMMON-DIVISOR,
;;; MONIC-POLYNOMIAL, SQUARE-FREE-PARTS, VALUE-OF-POLYNOMIAL, INTERPOLATED-POLYNOMIAL; RATIONAL-FROM-RESIDUE,
;;; JOINED-RESIDUE.
;;;
;;; Literature: J. von zur Gathen and J. Gerhard, Modern Computer Algebra (2013), 5.2, 5.10 and 11.1; D. Y. Y. Yun, On
;;; square-free decomposition algorithms, SYMSAC (1976) 26.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/residues" "arithmetic/series")

(declaim (ftype (function (t fixnum t fixnum) t) subtract-shifted))

(defun trimmed-polynomial (coefficients)
  (let ((end (position 0 coefficients :test-not #'eql :from-end t)))
    (if end (subseq coefficients 0 (1+ end)) '())))

(defun combined-polynomials (a factor b)
  "A + FACTOR * B."
  (trimmed-polynomial
   (loop while (or a b)
         collect (mod (+ (or (pop a) 0) (* factor (or (pop b) 0))) *prime*))))

(defun polynomial-product (a b)
  (let ((product '()))
    (dolist (coefficient (reverse a) product)
      (setq product (combined-polynomials (cons 0 product) coefficient b)))))

(defun subtract-shifted (rest factor b shift)
  "Change REST by - FACTOR * B * (variable ^ SHIFT)."
  (declare (type residues rest b) (fixnum factor shift))
  (with-fast-arithmetic
    (let* ((prime *prime*) (negative (fix (- prime factor))))
      (declare (fixnum prime negative))
      (for (k (length b))
        (let ((place (fix (+ k shift))))
          (declare (fixnum place))
          (setf (aref rest place) (plus-product (aref rest place) negative (aref b k) prime))))
      rest)))

(defun divided-polynomial (a b)
  "Quotient and remainder."
  (let ((inverse (inverse-residue (first (last b)))) (rest (fixnums a)) (divisor (fixnums b)) (quotient '()))
    (loop for shift from (- (length a) (length b)) downto 0
          do (let ((factor (mod (* inverse (aref rest (+ shift (length b) -1))) *prime*)))
               (push factor quotient)
               (subtract-shifted rest factor divisor shift)))
    (values (trimmed-polynomial quotient) (trimmed-polynomial (coerce rest 'list)))))

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

(defun value-of-polynomial (a x)
  (let ((value 0))
    (dolist (coefficient (reverse a) value)
      (setq value (mod (+ coefficient (* value x)) *prime*)))))

(defun interpolated-polynomial (function most)
  "The polynomial of degree below MOST with the values of FUNCTION, which may be nil at some places, so far as three
values more than needed tell; or nil (Newton)."
  (let ((polynomial '()) (basis '(1)) (idle 0))
    (loop for x from 1 to (+ most 20)
          until (= idle 3)
          do (let ((value (funcall function x)))
               (when value
                 (let ((error (mod (- value (value-of-polynomial polynomial x)) *prime*)))
                   (if (= error 0)
                       (incf idle)
                       (setq idle 0
                             polynomial (combined-polynomials
                                         polynomial
                                         (mod (* error (inverse-residue (value-of-polynomial basis x))) *prime*)
                                         basis)))
                   (setq basis (combined-polynomials (cons 0 basis) (- *prime* x) basis))))))
    (and (= idle 3) polynomial)))

;;; Rational numbers from residues

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
