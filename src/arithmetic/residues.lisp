;;; Residues modulo a prime.  Primes are below 2^30, so that a product and a sum are fixnums on every Lisp.
;;;
;;; Entry points: SUITABLE-PRIME, PLUS-PRODUCT, INVERSE-RESIDUE, POWER-RESIDUE, NUMBER-RESIDUE, ROOT-RESIDUE,
;;; INTEGER-ROOT-RESIDUE, INVERSE-MODULO, MONOMIAL-RESIDUE, TURN-RESIDUE, *PRIME*, *UNIT-ORDER*; POINT, *POINT*,
;;; NEW-POINT, RANDOM-RESIDUE, RANDOM-POWER, LEAVE-POINT.
;;;
;;; Literature: D. E. Knuth, The Art of Computer Programming 2, 4.5.4 and 4.6.2.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats")

(deftype residues () '(simple-array fixnum (*)))

;;; Roots of unity.  The residues but 0 are as many as *UNIT-ORDER* times a number prime to it.

(defvar *unit-order* 24 "The order of the roots of 1 that there are modulo the primes; a multiple of 24.")

(defvar *primes* (make-hash-table) "For each unit order the primes found so far, the largest first.")

(defun suitable-prime-p (n)
  "Whether N is a prime modulo which there are the roots of 1, square roots of -1 and of the primes up to 13, and few
other roots are missing."
  (declare (fixnum n))
  (and (= 1 (mod n *unit-order*))
       (= 1 (gcd *unit-order* (floor n *unit-order*)))
       (loop for (p . squares) in '((5 4) (7 2 4) (11 3 4 5 9) (13 3 4 9 10 12))
             always (or (= 0 (mod *unit-order* p)) (member (mod n p) squares)))
       (do ((divisor 3 (fix (+ divisor 2))))
           ((> (fix (* divisor divisor)) n) t)
         (declare (fixnum divisor))
         (when (= 0 (the fixnum (rem n divisor))) (return nil)))))

(defun suitable-prime (place)
  "The prime of that PLACE, from 0 on."
  (loop for primes = (gethash *unit-order* *primes*)
        while (<= (length primes) place)
        do (setf (gethash *unit-order* *primes*)
                 (append primes
                         (list (loop for n from (if primes (1- (first (last primes))) (1- (expt 2 30))) downto 3
                                     when (suitable-prime-p n) return n)))))
  (nth place (gethash *unit-order* *primes*)))

(defvar *prime* 1073741717)
(declaim (type fixnum *prime*))

(defmacro plus-product (a factor b prime)
  "A + FACTOR * B modulo PRIME, all of them fixnums."
  `(the fixnum (rem (the fixnum (+ (the fixnum ,a) (the fixnum (* (the fixnum ,factor) (the fixnum ,b)))))
                    (the fixnum ,prime))))

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
  (cond ((minusp exponent) (power-residue (inverse-residue a) (- exponent)))
        ((typep exponent 'fixnum) (natural-power-residue (mod a *prime*) exponent *prime*))
        ((= 0 (mod a *prime*)) 0)
        (t (power-residue a (mod exponent (1- *prime*))))))

(defun natural-power-residue (a exponent prime)
  (declare (fixnum a exponent prime))
  (let ((result 1))
    (declare (fixnum result))
    (loop until (= exponent 0)
          do (when (oddp exponent) (setq result (rem (fix (* result a)) prime)))
             (setq a (rem (fix (* a a)) prime)
                   exponent (ash exponent -1)))
    result))

(defun monomial-residue (exponents values)
  (let ((product 1))
    (loop for exponent in exponents
          for value in values
          do (setq product (mod (* product (power-residue value exponent)) *prime*)))
    product))

(defun number-residue (number)
  (if (integerp number)
      (mod number *prime*)
      (mod (* (numerator number) (inverse-residue (denominator number))) *prime*)))

(defvar *units* (make-hash-table :test #'equal) "What unit-residue found for each order and prime.")

(defun prime-divisors (n)
  (loop for divisor from 2 to n
        when (= 0 (mod n divisor))
          collect divisor and do (loop while (= 0 (mod n divisor)) do (setq n (floor n divisor)))))

(defun unit-residue ()
  "A primitive root of 1 of the order *UNIT-ORDER*, always the same."
  (let ((key (list *unit-order* *prime*)))
    (or (gethash key *units*)
        (setf (gethash key *units*)
              (loop with divisors = (prime-divisors *unit-order*)
                    for a from 2
                    unless (some (lambda (divisor) (= 1 (power-residue a (floor *prime* divisor)))) divisors)
                      return (power-residue a (floor *prime* *unit-order*)))))))

(defun turn-residue (turns)
  "exp(%i*%pi*TURNS), for a rational number whose denominator is in half the order of the units."
  (power-residue (unit-residue) (mod (* turns (floor *unit-order* 2)) *unit-order*)))

(defun root-residue (a order)
  "A root of A.  The residues are *unit-order* * m in number, m prime to that: A is a power of the unit times something
whose order divides m."
  (let* ((m (floor *prime* *unit-order*))
         (unit (unit-residue))
         (step (power-residue unit m))
         (image (power-residue a m))
         (turns (loop for k below *unit-order* when (= image (power-residue step k)) return k))
         (part (loop for k below *unit-order* when (eql turns (mod (* k order) *unit-order*)) return k))
         (inverse (or (inverse-modulo order m) (complain "roots of order ~d are not supported" order))))
    (if part
        (mod (* (power-residue unit part)
                (power-residue (mod (* a (power-residue unit (- turns))) *prime*) inverse))
             *prime*)
        (leave-point))))

(defun square-root-among-units (n)
  "The square root of the prime N that is a sum of roots of unity (Gauss), the positive one where those are exp(%i*phi);
or nil where it needs other roots of unity than there are."
  (flet ((sum-of-turns (terms)
           (mod (loop for (sign . turns) in terms sum (* sign (turn-residue turns))) *prime*)))
    (cond ((= n 2) (sum-of-turns '((1 . 1/4) (1 . -1/4))))
          ((and (oddp n) (= 0 (mod *unit-order* n)))
           (let ((sum (sum-of-turns (loop for k from 1 below n
                                          collect (cons (legendre-symbol k n) (/ (* 2 k) n))))))
             (if (= 1 (mod n 4)) sum (mod (* sum (turn-residue -1/2)) *prime*)))))))

(defun legendre-symbol (k prime)
  (if (= 1 (natural-power-residue k (floor prime 2) prime)) 1 -1))

(defun integer-root-residue (n order)
  "A root of the prime N that fits to the roots of unity."
  (let ((square-root (and (evenp order) (square-root-among-units n))))
    (if square-root (root-residue square-root (floor order 2)) (root-residue n order))))

;;; Points

(defstruct point
  "A PRIME, and the residues of nodes that have been drawn so far; STATE is that of the random numbers."
  prime state (residues (make-hash-table :test #'eq)) (functions (make-hash-table :test #'equal)))

(defvar *point* nil)

(defun new-point (seed prime)
  (make-point :prime prime :state (+ 88172645463325252 (* 7919 seed))))

(defun random-residue ()
  (setf (point-state *point*) (mod (+ 11 (* 25214903917 (point-state *point*))) 281474976710656))
  (1+ (mod (ash (point-state *point*) -10) (1- *prime*))))

(defun random-power ()
  "A power of which there are roots."
  (power-residue (random-residue) *unit-order*))

(defun leave-point ()
  "What is asked for does not exist at this point: another one is to be tried."
  (throw 'point :left))
