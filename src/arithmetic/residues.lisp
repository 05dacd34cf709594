;;; Residues modulo a prime.  Primes are below 2^30, so that a product and a sum are fixnums on every Lisp.
;;;
;;; Entry points: SUITABLE-PRIME, PLUS-PRODUCT, INVERSE-RESIDUE, POWER-RESIDUE, NUMBER-RESIDUE, ROOT-RESIDUE,
;;; INVERSE-MODULO, UNIT-RESIDUE, *PRIME*; POINT, *POINT*, NEW-POINT, RANDOM-RESIDUE, RANDOM-POWER, LEAVE-POINT.
;;;
;;; Literature: D. E. Knuth, The Art of Computer Programming 2, 4.5.4 and 4.6.2.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats")

(deftype residues () '(simple-array fixnum (*)))

(defvar *primes* '() "The primes found so far, the smallest first.")

(defun suitable-prime-p (n)
  "Whether N is a prime modulo which -1 and the primes up to 13 have square roots, and few other roots are missing."
  (declare (fixnum n))
  (and (= 25 (mod n 48))
       (= 4 (mod n 5))
       (member (mod n 7) '(2 4))
       (member (mod n 11) '(3 4 5 9))
       (member (mod n 13) '(3 4 9 10 12))
       (/= 1 (mod n 9))
       (do ((divisor 3 (fix (+ divisor 2))))
           ((> (fix (* divisor divisor)) n) t)
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

(defun number-residue (number)
  (if (integerp number)
      (mod number *prime*)
      (mod (* (numerator number) (inverse-residue (denominator number))) *prime*)))

(defvar *units* (make-hash-table) "What unit-residue found for each prime.")

(defun unit-residue ()
  "A primitive root of 1 of order 24."
  (or (gethash *prime* *units*)
      (setf (gethash *prime* *units*)
            (loop for a from 2
                  unless (or (= 1 (power-residue a (floor *prime* 2))) (= 1 (power-residue a (floor *prime* 3))))
                    return (power-residue a (floor *prime* 24))))))

(defun root-residue (a order)
  "A root of A.  The residues are 24 * m in number, m prime to 24: A is a power of the unit times something whose order
divides m."
  (let* ((m (floor *prime* 24))
         (unit (unit-residue))
         (step (power-residue unit m))
         (image (power-residue a m))
         (turns (loop for k below 24 when (= image (power-residue step k)) return k))
         (part (loop for k below 24 when (eql turns (mod (* k order) 24)) return k))
         (inverse (or (inverse-modulo order m) (complain "roots of order ~d are not supported" order))))
    (if part
        (mod (* (power-residue unit part)
                (power-residue (mod (* a (power-residue unit (- turns))) *prime*) inverse))
             *prime*)
        (leave-point))))

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
  (power-residue (random-residue) 24))

(defun leave-point ()
  "What is asked for does not exist at this point: another one is to be tried."
  (throw 'point :left))
