;;; anmech: functions with kinks: abs, signum, max, min, unit_step and conditionals.
;;;
;;; Two of them say what all do: max(a, b) = (a + b + abs(a - b))/2, unit_step(u) = (1 + signum(u))/2, and a conditional
;;; chooses by signum.  Absolute values and signs of products are products of those of the factors, so that a kink lies
;;; where one irreducible u vanishes; on either side of it abs(u) = u, signum(u) = 1, or abs(u) = -u, signum(u) = -1.
;;; The values at the kinks themselves, one point on every path that crosses them, are left open.
;;;
;;; Entry points: anmech_floors_apart, anmech_by_signs, anmech_kinks_of, anmech_on_side, anmech_glued, anmech_has_kinks,
;;; anmech_regular_at_kinks; BY-SIGNS, ABS-OF, SIGN-OF, HALVES, PARTS-IF-IN-STEPS, KINKED-OPERATOR-P,
;;; *WRITTEN-BY-SIGNS*, *FLOORS*.

(in-package :anmech)
(needs "session/scope" "algebra/terms")

(defparameter *written-by-signs* '(maxima::$max maxima::$min maxima::$unit_step maxima::mcond)
  "Operators that abs and signum say.")

(defun kinked-operator-p (form)
  (or (member (caar form) '(maxima::mabs maxima::%signum)) (member (caar form) *written-by-signs*)))

(defun abs-of (form) (maxima::simplify (list '(maxima::mabs) form)))
(defun sign-of (form) (maxima::simplify (list '(maxima::%signum) form)))

(defparameter *floors*
  '(maxima::$floor maxima::%floor maxima::$ceiling maxima::%ceiling maxima::$round maxima::%round maxima::$truncate
    maxima::%truncate)
  "Operators that are constant between their jumps.")

(maxima::defmfun maxima::$anmech_floors_apart (form)
  "anmech_floors_apart(expr): [expr with constants for floor and its relatives, [constant = what it stands for, ...]];
mod(u, v) is u - v*floor(u/v)."
  (let ((found '()))
    (labels ((constant-for (form)
               (first (or (find form found :key #'second :test #'maxima::alike1)
                          (first (push (list (maxima::$gensym) form) found)))))
             (walk (form)
               (cond ((atom form) form)
                     ((member (caar form) *floors*) (constant-for form))
                     ((and (member (caar form) '(maxima::$mod maxima::%mod)) (= 3 (length form)))
                      (destructuring-bind (u v) (rest form)
                        (maxima::sub (walk u)
                                     (maxima::mul (walk v) (constant-for (function-of 'maxima::$floor
                                                                                      (maxima::div u v)))))))
                     ((member 'maxima::array (cdar form)) form)
                     (t (with-arguments form (mapcar #'walk (rest form)))))))
      (let ((apart (walk form)))
        (maxima-list (list apart (maxima-list (loop for (name part) in found
                                                    collect `((maxima::mequal maxima::simp) ,name ,part)))))))))

(defun halves (sum-or-difference a b)
  (maxima::div (funcall sum-or-difference a b) 2))

(defun larger-by-signs (a b) (halves #'maxima::add (maxima::add a b) (abs-of (maxima::sub a b))))
(defun smaller-by-signs (a b) (halves #'maxima::sub (maxima::add a b) (abs-of (maxima::sub a b))))

(defun by-signs (form)
  "FORM with max, min, unit_step and conditionals written by abs and signum, and these of irreducible arguments."
  (if (or (atom form) (not (some-part #'kinked-operator-p form)))
      form
      (let ((parts (mapcar #'by-signs (rest form))))
        (case (caar form)
          (maxima::mabs (split-by-factors #'abs-of (first parts)))
          (maxima::%signum (split-by-factors #'sign-of (first parts)))
          (maxima::$max (by-signs-once (reduce #'larger-by-signs parts)))
          (maxima::$min (by-signs-once (reduce #'smaller-by-signs parts)))
          (maxima::$unit_step (halves #'maxima::add 1 (split-by-factors #'sign-of (off-zero (first parts) -1))))
          (maxima::mcond (chosen-by-signs form))
          (maxima::mexpt (power-by-signs (with-arguments form parts)))
          (t (with-arguments form parts))))))

(defun power-by-signs (form)
  "1/abs(u) is signum(u)/u, so that u/abs(u) is a sign; FORM is a power, or the product of powers that it has become."
  (cond ((operator-p form 'maxima::mtimes) (apply #'product-of (mapcar #'power-by-signs (rest form))))
        ((and (operator-p form 'maxima::mexpt) (operator-p (second form) 'maxima::mabs)
              (integerp (third form)) (minusp (third form)) (oddp (third form)))
         (maxima::mul (sign-of (second (second form))) (power-of (second (second form)) (third form))))
        (t form)))

(defun by-signs-once (form)
  "FORM, in which abs and signum may have reducible arguments."
  (if (atom form)
      form
      (let ((parts (mapcar #'by-signs-once (rest form))))
        (case (caar form)
          (maxima::mabs (split-by-factors #'abs-of (first parts)))
          (maxima::%signum (split-by-factors #'sign-of (first parts)))
          (t (with-arguments form parts))))))

(defun split-by-factors (function argument)
  "The product of FUNCTION, abs or signum, of the factors of ARGUMENT."
  (let ((factored (if (atom argument) argument (maxima::$factor argument))))
    (if (or (operator-p factored 'maxima::mtimes) (operator-p factored 'maxima::mexpt))
        (apply #'product-of
               (mapcar (lambda (factor) (of-factor function factor))
                       (if (operator-p factored 'maxima::mtimes) (rest factored) (list factored))))
        (of-factor function argument))))

(defun of-factor (function factor)
  (cond ((member (maxima::$csign factor) '(maxima::$pos)) (if (eq function #'sign-of) 1 factor))
        ((and (operator-p factor 'maxima::mexpt) (integerp (third factor)))
         (let ((inner (of-factor function (second factor))))
           (cond ((not (eq function #'sign-of)) (power-of inner (third factor)))
                 ((evenp (third factor)) 1)
                 (t inner))))
        (t (funcall function factor))))

;;; Conditionals

(defun chosen-by-signs (form)
  "A conditional by signum; FORM itself if a condition is no comparison."
  (let ((arguments (rest form)))
    (labels ((chosen (pairs positive)
               (unless pairs (throw 'no-comparison nil))
               (destructuring-bind (condition value . others) pairs
                 (if (eq condition t)
                     (by-signs (real-where positive value))
                     (let ((u (plain-difference condition)))
                       (choice condition
                               (by-signs (real-where (if u (cons u positive) positive) value))
                               (chosen others (if u (cons (maxima::neg u) positive) positive))))))))
      (or (catch 'no-comparison (chosen arguments '())) form))))  ; a condition that is none, or no value for the rest

(defun real-where (positive form)
  "FORM, which counts only where all of POSITIVE are positive, with a value also where they are not: roots and
logarithms of multiples of one of them are those of its absolute value, and those of what may be negative elsewhere are
of 1."
  (labels ((walk (form)
             (cond ((or (atom form) (null positive)) form)
                   ((and (operator-p form 'maxima::mexpt) (not (integerp (third form))))
                    (power-of (real-base (walk (second form)) '(maxima::$pos maxima::$pz)) (walk (third form))))
                   ((operator-p form 'maxima::%log)
                    (with-arguments form (list (real-base (walk (second form)) '(maxima::$pos)))))
                   (t (with-arguments form (mapcar #'walk (rest form))))))
           (real-base (base signs)
             (let ((u (find-if (lambda (u) (positive-multiple-p base u)) positive)))
               (cond (u (maxima::mul (maxima::$ratsimp (maxima::div base u)) (abs-of u)))
                     ((or (eq base 'maxima::$%e) (member (maxima::$csign base) signs)) base)
                     (t (let ((here (apply #'product-of (mapcar #'indicator-of positive))))
                          (maxima::add (maxima::mul here base) (maxima::sub 1 here))))))))
    (walk form)))

(defun indicator-of (u) (halves #'maxima::add 1 (split-by-factors #'sign-of (by-signs u))))

(defun positive-multiple-p (form u)
  (and (not (maxima::$numberp form))
       (let ((ratio (maxima::$ratsimp (maxima::div form u))))
         (and (maxima::$constantp ratio) (eq 'maxima::$pos (maxima::$csign ratio))))))

(defun choice (condition yes no)
  (let ((u (compared-side condition)))
    (if u
        (bent u yes no)
        (maxima::add no (maxima::mul (indicator condition) (maxima::sub yes no))))))

(defun bent (u yes no)
  "YES where U is positive, NO where it is negative: with abs(u) where their difference vanishes with U, else by
signum(u).  Each of them times what is 1 or 0: sums of halves would leave roundings of what is not chosen."
  (let* ((mean (halves #'maxima::add yes no)) (half (halves #'maxima::sub yes no))
         (quotient (if (maxima::$freeof u half) nil (maxima::$ratsimp (maxima::div half u))))
         (smooth (and quotient (maxima::$numberp (maxima::$ratsimp (maxima::$denom quotient))))))
    (cond ((eql half 0) mean)
          (smooth (maxima::add mean (maxima::mul quotient (split-by-factors #'abs-of u))))
          (t (let ((sign (split-by-factors #'sign-of u)))
               (if (or (eql mean 0) (and (atom yes) (atom no)))
                   (maxima::add mean (maxima::mul half sign))
                   (maxima::add (maxima::mul yes (halves #'maxima::add 1 sign))
                                (maxima::mul no (halves #'maxima::sub 1 sign)))))))))

(defun plain-difference (condition)
  "u of the comparison u > 0 that CONDITION is, off the kink; nil if it is something else."
  (and (consp condition)
       (case (caar condition)
         (maxima::mgreaterp (off-zero (maxima::sub (second condition) (third condition)) -1))
         (maxima::mgeqp (off-zero (maxima::sub (second condition) (third condition)) 1))
         (maxima::mlessp (off-zero (maxima::sub (third condition) (second condition)) -1))
         (maxima::mleqp (off-zero (maxima::sub (third condition) (second condition)) 1)))))

;;; What is whole between jumps, as floor(t), may be 0 for long

(defun parts-of-whole (form)
  "k, if FORM is always a multiple of 1/k, since it is made of floors and their like; else nil."
  (cond ((maxima::$ratnump form) (maxima::$denom form))
        ((atom form) nil)
        ((or (member (caar form) *floors*) (member (caar form) '(maxima::%signum maxima::$unit_step))) 1)
        ((and (member (caar form) '(maxima::$mod maxima::%mod)) (integerp (third form))) (parts-of-whole (second form)))
        (t (let* ((parts (mapcar #'parts-of-whole (rest form))) (all (every #'identity parts)))
             (case (caar form)
               (maxima::mabs (first parts))
               (maxima::mplus (and all (apply #'lcm parts)))
               (maxima::mtimes (and all (apply #'* parts)))
               (maxima::mexpt (and all (typep (third form) '(integer 1)) (expt (first parts) (third form)))))))))

(defun parts-if-in-steps (form)
  "The same of what has floors in it, but for a number that is added; nil also if that keeps it off whole numbers."
  (when (some-part (lambda (part) (member (caar part) (list* 'maxima::$mod 'maxima::%mod *floors*))) form)
    (let* ((number (if (operator-p form 'maxima::mplus) (or (find-if #'maxima::$ratnump (rest form)) 0) 0))
           (k (parts-of-whole (maxima::sub form number))))
      (and k (integerp (maxima::mul k number)) k))))

(defun off-zero (form sign)
  "FORM, or what is on the side SIGN of 0 where that is 0 between jumps, and else on its side."
  (let ((k (parts-if-in-steps form)))
    (if k (maxima::add form (maxima::div sign (* 2 k))) form)))

(defun compared-side (condition)
  "The same by signs."
  (let ((u (plain-difference condition))) (and u (by-signs u))))

(defun indicator (condition)
  "1 where CONDITION holds, 0 elsewhere."
  (let ((u (compared-side condition)))
    (cond (u (indicator-of u))
          ((eq condition t) 1)
          ((eq condition nil) 0)
          ((atom condition) (throw 'no-comparison nil))
          (t (case (caar condition)
               (maxima::mand (apply #'product-of (mapcar #'indicator (rest condition))))
               (maxima::mor (maxima::sub 1 (apply #'product-of
                                                  (mapcar (lambda (part) (maxima::sub 1 (indicator part)))
                                                          (rest condition)))))
               (maxima::mnot (maxima::sub 1 (indicator (second condition))))
               ((maxima::mequal maxima::$equal) 0)
               ((maxima::mnotequal maxima::$notequal) 1)
               (t (throw 'no-comparison nil)))))))

;;; Sides

(defun continuous-p (form)
  "Whether FORM is an integral: it has one value at the kinks of what it is taken of, and on either side of them
another meaning than the integral of what that is there."
  (eq (caar form) 'maxima::%integrate))

(defun kinks-of (form)
  "The arguments of abs and signum in FORM, but for those in integrals."
  (let ((found '()))
    (labels ((add (u)
               (unless (or (member u found :test #'maxima::alike1)
                           (member (maxima::neg u) found :test #'maxima::alike1))
                 (push u found)))
             (walk (form)
               (unless (or (atom form) (continuous-p form))
                 (when (member (caar form) '(maxima::mabs maxima::%signum)) (add (second form)))
                 (mapc #'walk (rest form)))))
      (walk form))
    (nreverse found)))

(defun on-side (form u sign)
  "FORM where SIGN, 1 or -1, is the sign of U."
  (let ((minus (maxima::neg u)))
    (labels ((known (argument)
               (cond ((maxima::alike1 argument u) sign)
                     ((maxima::alike1 argument minus) (- sign))))
             (walk (form)
               (if (or (atom form) (continuous-p form))
                   form
                   (let ((side (and (member (caar form) '(maxima::mabs maxima::%signum)) (known (second form)))))
                     (cond ((null side) (with-arguments form (mapcar #'walk (rest form))))
                           ((eq (caar form) 'maxima::mabs) (maxima::mul side (second form)))
                           (t side))))))
      (walk form))))

;;; The thin layer

(maxima::defmfun maxima::$anmech_has_kinks (form)
  "anmech_has_kinks(expr): whether abs, signum, max, min, unit_step or a conditional occurs."
  (and (some-part #'kinked-operator-p form) t))

(maxima::defmfun maxima::$anmech_by_signs (form)
  "anmech_by_signs(expr): max, min, unit_step and conditionals by abs and signum, these of irreducible arguments."
  (by-signs form))

(maxima::defmfun maxima::$anmech_glued (u above below)
  "anmech_glued(u, e, f): e where u > 0, f where u < 0, by signum(u), or by abs(u) where e - f vanishes with u."
  (bent u above below))

(maxima::defmfun maxima::$anmech_kinks_of (form)
  "anmech_kinks_of(expr): what abs and signum are taken of in it."
  (maxima-list (kinks-of (by-signs form))))

(maxima::defmfun maxima::$anmech_on_side (form u sign)
  "anmech_on_side(expr, u, sign): expr where u has the sign 1 or -1; expr as anmech_by_signs gives it."
  (on-side form u sign))

;;; Where powers of u and abs(u) meet

(defun regular-at-kinks (form)
  "FORM with signum(u)^n abs(u)^(n + p) for u^n abs(u)^p, which may have no value at 0 though it has a limit there."
  (if (or (atom form) (not (some-part #'power-of-abs-p form)))
      form
      (regular-product (with-arguments form (mapcar #'regular-at-kinks (rest form))))))

(defun power-of-abs-p (form)
  "Whether FORM is a power of abs(u) that may have no value at 0."
  (and (operator-p form 'maxima::mexpt) (operator-p (second form) 'maxima::mabs)
       (not (typep (third form) '(integer 0)))))

(defun regular-product (form)
  "FORM, whose factors are regular; those that are sums are multiplied out where a term holds the power of abs(u)."
  (if (operator-p form 'maxima::mtimes)
      (or (some (lambda (factor)
                  (let ((others (remove factor (rest form) :test #'eq :count 1)))
                    (some (lambda (other)
                            (let ((product (joined-with-abs factor other)))
                              (and product (regular-product
                                            (apply #'product-of product
                                                   (remove other others :test #'eq :count 1))))))
                          others)))
                (rest form))
          form)
      form))

(defun joined-with-abs (factor other)
  "The product of FACTOR, u^n, and OTHER where that is a power of abs(u), or a sum that holds one; else nil."
  (multiple-value-bind (u n) (if (operator-p factor 'maxima::mexpt)
                                 (values (second factor) (third factor))
                                 (values factor 1))
    (flet ((of-u-p (form)
             (and (power-of-abs-p form)
                  (let ((v (second (second form))))
                    (or (maxima::alike1 u v) (maxima::alike1 u (maxima::neg v)))))))
      (cond ((or (not (typep n '(integer 1))) (maxima::$numberp u)) nil)
            ((of-u-p other)
             (product-of (if (oddp n) (sign-of u) 1) (power-of (second other) (maxima::add n (third other)))))
            ((and (operator-p other 'maxima::mplus)
                  (some (lambda (term) (or (of-u-p term) (and (operator-p term 'maxima::mtimes)
                                                              (some #'of-u-p (rest term)))))
                        (rest other)))
             (sum-of (mapcar (lambda (term) (regular-product (product-of factor term))) (rest other))))))))

(maxima::defmfun maxima::$anmech_regular_at_kinks (form)
  "anmech_regular_at_kinks(expr): expr with signum(u)^n*abs(u)^(n + p) for u^n*abs(u)^p."
  (regular-at-kinks form))
