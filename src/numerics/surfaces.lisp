;;; anmech: right sides with kinks and jumps, made smooth: on each side of the surfaces where they switch.
;;;
;;; abs, signum, unit_step, max, min and conditionals switch where a function g of states and time vanishes, on a
;;; *surface*.  Each surface has a *side*, two numbers (w, v): (1, 0) where g > 0, (0, 1) where g < 0.  With these as
;;; further inputs, constant as long as no surface is crossed, the right sides are smooth:
;;;
;;;   abs(g) = (w - v) g,   signum(g) = w - v,   max(a, b) = w a + v b,   unit_step(g) = w,
;;;
;;; and so on, also one in the other.  Sums of such products keep every digit of what is chosen.  A signum of 0 is (1/2,
;;; 1/2); between the sides, any (w, v) with w + v = 1 is a mean of both.
;;;
;;; A stage of a step may look beyond the surface on which the step will end, where roots need have no value.  So what
;;; abs, max and min give to a root or a logarithm is left as it is; and a root of something that jumps is taken of 0
;;; where that is negative, but only beyond a surface.
;;;
;;; floor and its relatives jump at every integer: floor(u) is written by the sign s of sin(%pi*u), as
;;; u - 1/2 + atan2(s cos(%pi*u), s sin(%pi*u))/%pi, which goes on smoothly beyond the jump on either side.
;;;
;;; Entry points: FLOORS-BY-SIGNS, SMOOTH-ON-SIDES; the structure SURFACES with SURFACES-COUNT, SURFACES-BASE,
;;; SURFACES-WHERE; COMPILED-SURFACES, FIND-VALUES, PUT-SIDE, SIDE-AT, PUT-SIGNS, SURFACE-RATE,
;;; REMOVE-SURFACE-RATE, MOVE-ACROSS-SURFACE, SURFACES-ROOM, SURFACES-BOUNDED, SIDE-INPUTS, AS-GIVEN.

(in-package :anmech)
(needs "session/scope" "session/texts" "arithmetic/floats" "algebra/kinks" "algebra/rootsums" "algebra/terms"
       "numerics/codegen")

(defstruct (surfaces (:print-function print-surfaces))
  (count 0 :type fixnum)
  (base 0 :type fixnum)             ; the place of the first side in the input
  where                             ; expressions g, later ones in the sides of earlier ones
  shown                             ; the same as they were given
  at-zero                           ; of each, the sign that counts where g = 0: 1, -1 or 0
  inputs                            ; two symbols for each
  bounded                           ; whether there are roots of what jumps, taken of 0 where that is negative
  entries                           ; pairs (surface . variable) of the derivatives that do not vanish
  values                            ; (in out): the values of all g
  function)                         ; (in out): these, then the derivatives

(defun print-surfaces (surfaces stream depth)
  (declare (ignore depth))
  (format stream "#<~d surfaces>" (surfaces-count surfaces)))

;;; Conversion

(defvar *surfaces-found* nil "The last first: lists (g w v sign-at-zero shown).")
(defvar *varying* nil "The states and the time.")
(defvar *bounded* nil "Whether roots have been bounded.")

(defun smooth-on-sides (expressions varying)
  "EXPRESSIONS, smooth in VARYING on each side; and the surfaces, nil if there are none."
  (if (notany (lambda (form) (some-part #'kinked-operator-p form)) expressions)
      (values expressions nil)
      (let* ((*surfaces-found* '()) (*varying* varying) (*bounded* nil)
             (smooth (mapcar (lambda (form) (smooth-form form nil)) expressions))
             (found (reverse *surfaces-found*)))
        (values smooth
                (and found
                     (make-surfaces :count (length found) :where (mapcar #'first found) :bounded *bounded*
                                    :inputs (loop for (nil w v) in found append (list w v))
                                    :at-zero (mapcar #'fourth found) :shown (mapcar #'fifth found)))))))

(defun floors-by-signs (form varying)
  "FORM with floor, ceiling, round, truncate and mod of what depends on VARYING written by signs."
  (if (or (atom form) (member 'maxima::array (cdar form)))
      form
      (let* ((form (alternating (off-the-jumps form)))
             (parts (mapcar (lambda (part) (floors-by-signs part varying)) (rest form)))
             (*varying* varying))
        (or (and (switches-p form) (by-floors (caar form) (first parts) (second parts)))
            (with-arguments form parts)))))

(defun alternating (form)
  "FORM; if it is a power of -1, as (-1)^floor(t), by a cosine, which has a value also for an exponent that is whole but
for roundings."
  (if (and (operator-p form 'maxima::mexpt) (eql -1 (second form)) (eql 1 (parts-if-in-steps (third form))))
      (maxima::simplify (list '(maxima::%cos) (maxima::mul 'maxima::$%pi (third form))))
      form))

(defun off-the-jumps (form)
  "FORM, where what it does depends on a number that is whole, or a multiple of 1/k, between jumps, as in
mod(floor(t), 2): with that number moved by half of such a part, since rounding would decide where it is on a jump."
  (destructuring-bind (&optional (a 0) b &rest more) (rest form)
    (let ((k (and (null more) (parts-if-in-steps a))))
      (flet ((is (&rest names) (member (caar form) names))
             (without-noise (a) (off-the-jumps (function-of 'maxima::$floor a)))
             (moved (a) (maxima::add a (maxima::div 1 (maxima::mul 2 k)))))
        (cond ((null k) form)
              ((is 'maxima::$floor 'maxima::%floor) (function-of 'maxima::$floor (moved a)))
              ((is 'maxima::$ceiling 'maxima::%ceiling)
               (function-of 'maxima::$ceiling (maxima::neg (moved (maxima::neg a)))))
              ((is 'maxima::$round 'maxima::%round) (without-noise (maxima::add a (maxima::div 1 2))))
              ((and (is 'maxima::$mod 'maxima::%mod) (typep b '(integer 1)))
               (maxima::sub a (maxima::mul b (without-noise (maxima::div a b)))))
              ((is 'maxima::%signum)
               (halves #'maxima::sub (sign-of (moved a)) (sign-of (moved (maxima::neg a)))))
              ((is 'maxima::$unit_step)
               (maxima::sub 1 (function-of 'maxima::$unit_step (moved (maxima::neg a)))))
              (t form))))))

(defun by-floors (operator u v)
  "OPERATOR of U, or of U and V, by signs; nil if it is none of those that are written so."
  (case operator
    ((maxima::$floor maxima::%floor) (floor-by-sign u))
    ((maxima::$ceiling maxima::%ceiling) (maxima::neg (floor-by-sign (maxima::neg u))))
    ((maxima::$round maxima::%round) (floor-by-sign (maxima::add u (maxima::div 1 2))))
    ((maxima::$truncate maxima::%truncate) (maxima::mul (sign-of u) (floor-by-sign (abs-of u))))
    ((maxima::$mod maxima::%mod) (maxima::sub u (maxima::mul v (floor-by-sign (maxima::div u v)))))))

(defun floor-by-sign (u)
  (let* ((angle (maxima::mul 'maxima::$%pi u))
         (sine (maxima::simplify (list '(maxima::%sin) angle)))
         (cosine (maxima::simplify (list '(maxima::%cos) angle)))
         (sign (sign-of sine)))
    (maxima::add u (maxima::div -1 2)
                 (maxima::div (maxima::simplify (list '(maxima::%atan2) (maxima::mul sign cosine)
                                                      (maxima::mul sign sine)))
                              'maxima::$%pi))))

(defun switches-p (form)
  "Whether FORM may change its sign along a motion."
  (some (lambda (variable) (not (maxima::$freeof variable form))) *varying*))

(defun smooth-form (form guarded)
  "FORM in the sides of surfaces.  GUARDED: it is the argument of a function with a domain."
  (flet ((smooth (part) (smooth-form part guarded)))
    (if (or (atom form) (not (some-part #'kinked-operator-p form)))
        form
        (case (caar form)
          (maxima::mabs (smooth-abs (second form) guarded))
          (maxima::%signum (if (switches-p form) (smooth-sign (second form)) form))
          (maxima::$unit_step (values (side-of (smooth (second form)) -1 (second form))))
          (maxima::$max (reduce (lambda (a b) (larger-of a b guarded)) (mapcar #'smooth (rest form))))
          (maxima::$min (maxima::neg (reduce (lambda (a b) (larger-of a b guarded))
                                             (mapcar (lambda (part) (maxima::neg (smooth part))) (rest form)))))
          (maxima::mcond (smooth-conditional form guarded))
          (maxima::mexpt (smooth-power (second form) (third form)))
          ((maxima::%log maxima::%asin maxima::%acos maxima::%acosh maxima::%atanh)
           (with-arguments form (list (smooth-form (second form) t))))
          ((maxima::mplus maxima::mtimes) (with-arguments form (mapcar #'smooth (rest form))))
          (t (if (member 'maxima::array (cdar form))
                 form
                 (with-arguments form (mapcar (lambda (part) (smooth-form part nil)) (rest form)))))))))

(defun smooth-conditional (form guarded)
  (let ((written (by-signs form)))
    (if (operator-p written 'maxima::mcond)
        (complain "the conditions of ~a are no comparisons of numbers" (one-line form))
        (smooth-form written guarded))))

(defun side-of (g at-zero shown)
  "The side (w, v) of the surface where G vanishes, two values; AT-ZERO: the sign that counts there; SHOWN: G as it was
given."
  (let ((same (find g *surfaces-found* :test #'maxima::alike1 :key #'first))
        (other (find (maxima::neg g) *surfaces-found* :test #'maxima::alike1 :key #'first)))
    (cond (same (values (second same) (third same)))
          (other (values (third other) (second other)))
          ((maxima::$numberp g) (let ((sign (maxima::$csign g)))
                                  (if (or (eq sign 'maxima::$pos) (and (eq sign 'maxima::$zero) (plusp at-zero)))
                                      (values 1 0)
                                      (values 0 1))))
          (t (let ((w (maxima::$gensym)) (v (maxima::$gensym)))
               (push (list g w v at-zero shown) *surfaces-found*)
               (values w v))))))

(defun sign-from (g shown)
  (multiple-value-bind (w v) (side-of g 0 shown) (maxima::sub w v)))

(defun irreducible-powers (form)
  "FORM as a product of irreducible ones, pairs (factor . exponent); of long ones, as it stands."
  (let ((factored (if (or (atom form) (some-part #'kinked-operator-p form) (> (maxima::conssize form) 500))
                      form
                      (maxima::$factor form))))
    (mapcar (lambda (factor)
              (if (and (operator-p factor 'maxima::mexpt) (integerp (third factor)))
                  (cons (second factor) (third factor))
                  (cons factor 1)))
            (if (operator-p factored 'maxima::mtimes) (rest factored) (list factored)))))

(defun smooth-sign (argument)
  (apply #'product-of
         (loop for (factor . exponent) in (irreducible-powers argument)
               unless (or (evenp exponent) (eq (maxima::$csign factor) 'maxima::$pos))
                 collect (if (switches-p factor)
                             (sign-from (smooth-form factor nil) factor)
                             (sign-of factor)))))

(defun smooth-abs (argument guarded)
  (let ((inner (smooth-form argument guarded)))
    (cond ((not (switches-p argument)) (abs-of inner))
          (guarded (side-of inner 0 argument) (abs-of inner))
          (t (maxima::mul (smooth-sign argument) inner)))))

(defun larger-of (a b guarded)
  (multiple-value-bind (w v) (side-of (maxima::sub a b) 0 (maxima::sub a b))
    (if guarded
        (largest-of a b)
        (maxima::add (maxima::mul w a) (maxima::mul v b)))))

(defun smooth-power (base exponent)
  (cond ((eq base 'maxima::$%e) (power-of base (smooth-form exponent nil)))
        ((and (integerp exponent) (operator-p base 'maxima::mabs) (switches-p base))
         (maxima::mul (if (evenp exponent) 1 (smooth-sign (second base)))
                      (power-of (smooth-form (second base) nil) exponent)))
        ((integerp exponent) (power-of (smooth-form base nil) exponent))
        (t (power-of (bounded-beyond (smooth-form base t) base) (smooth-form exponent nil)))))

(defparameter *beyond* (expt 10 30) "So steep is the bound of what has no value beyond a surface.")

(defun bounded-beyond (smooth base)
  "SMOOTH, of which a root is taken; not negative beyond those surfaces where BASE jumps."
  (let ((signs (remove-if-not (lambda (found) (or (contains-p (second found) smooth) (contains-p (third found) smooth)))
                              *surfaces-found*)))
    (if (or (null signs) (not (some-part (lambda (part) (eq (caar part) 'maxima::%signum)) base)))
        smooth
        (flet ((on-its-side (found)
                 (destructuring-bind (g w v &rest others) found
                   (declare (ignore others))
                   (maxima::mul (maxima::sub w v) g))))
          (setq *bounded* t)
          (largest-of smooth
                      (smallest-of 0 (maxima::mul (- *beyond*)
                                                  (reduce #'smallest-of (mapcar #'on-its-side signs)))))))))

(defun unbounded (form)
  "FORM without the bounds of BOUNDED-BEYOND."
  (flet ((bound-p (part)
           (and (operator-p part 'maxima::$min)
                (some (lambda (argument) (and (operator-p argument 'maxima::mtimes) (member (- *beyond*) argument)))
                      (rest part)))))
    (cond ((or (atom form) (member 'maxima::array (cdar form))) form)
          ((and (operator-p form 'maxima::$max) (some #'bound-p (rest form)))
           (unbounded (first (remove-if #'bound-p (rest form)))))
          (t (with-arguments form (mapcar #'unbounded (rest form)))))))

(defun as-given (surfaces form)
  "FORM, in the sides of SURFACES, for people."
  (loop for (w v) on (surfaces-inputs surfaces) by #'cddr
        for g in (surfaces-shown surfaces)
        do (setq form (maxima::maxima-substitute
                       (if (contains-p v form)
                           (maxima::add (sign-of g) v)
                           (function-of 'maxima::$unit_step g))
                       w form)
                 form (maxima::maxima-substitute (function-of 'maxima::$unit_step (maxima::neg g)) v form)))
  (unbounded form))

(defun contains-p (symbol form) (not (maxima::$freeof symbol form)))
(defun largest-of (a b) (maxima::simplify (list '(maxima::$max) a b)))
(defun smallest-of (a b) (maxima::simplify (list '(maxima::$min) a b)))

;;; In numbers

(defun with-known-angles (form)
  "FORM with those of FLOOR-BY-SIGN by the name under which this Maxima has their derivatives."
  (subst *angle* 'maxima::%atan2 form))

(defun compiled-surfaces (surfaces inputs varying)
  "SURFACES, with their code: INPUTS are those of the field, but for the sides."
  (when surfaces
    (let* ((where (surfaces-where surfaces))
           (slopes (loop for g in where
                         for i from 0
                         append (loop for variable in varying
                                      for j from 0
                                      for slope = (maxima::$diff (with-known-angles g) variable)
                                      unless (eql slope 0) collect (list (cons i j) slope)))))
      (setf (surfaces-base surfaces) (length inputs)
            (surfaces-entries surfaces) (mapcar #'first slopes)
            (surfaces-values surfaces)
            (values (compile-expressions where (append inputs (surfaces-inputs surfaces))))
            (surfaces-function surfaces)
            (values (compile-expressions (append where (mapcar #'second slopes))
                                         (append inputs (surfaces-inputs surfaces)))))
      surfaces)))

(defun find-values (surfaces in out)
  "The values of all g at IN, and their derivatives, go to OUT.  One that has no value, as that of sqrt(t) at 0, or that
of a tanh that is 1, counts as 0: nothing slides along there."
  (handler-case (funcall (the function (surfaces-function surfaces)) in out)
    ((or domain-violation arithmetic-error) ()
      (fill (the double-array out) 0d0)
      (funcall (the function (surfaces-values surfaces)) in out))))

(defun side-inputs (surfaces) (and surfaces (surfaces-inputs surfaces)))

(defun surfaces-room (surfaces) (+ (surfaces-count surfaces) (length (surfaces-entries surfaces))))

(defun put-side (surfaces point i sign)
  "Note in POINT that the surface I has the side SIGN, 1 or -1 or between."
  (declare (type double-array point))
  (let ((place (+ (surfaces-base surfaces) (* 2 i))))
    (setf (aref point place) (* 0.5d0 (+ 1d0 sign))
          (aref point (1+ place)) (* 0.5d0 (- 1d0 sign)))
    nil))

(defun side-at (surfaces point i)
  "The sign that is noted in POINT."
  (declare (type double-array point))
  (let ((place (+ (surfaces-base surfaces) (* 2 i))))
    (- (aref point place) (aref point (1+ place)))))

(defun put-signs (surfaces point)
  "Note in POINT on which sides it is: in the order of the surfaces, for some depend on the sides of others."
  (let ((values (make-array (surfaces-count surfaces) :element-type 'double-float)))
    (loop for at-zero in (surfaces-at-zero surfaces)
          for i from 0
          do (funcall (the function (surfaces-values surfaces)) point values)
             (let ((g (aref values i)))
               (put-side surfaces point i (float (if (zerop g) at-zero (signum g)) 1d0))))
    point))

(defun surface-rate (surfaces i values rates)
  "The rate of g of the surface I, where VALUES are those of the function and RATES of the states."
  (declare (type double-array values rates))
  (let ((n (length rates)) (count (surfaces-count surfaces)) (rate 0d0))
    (loop for (surface . variable) in (surfaces-entries surfaces)
          for place from count
          do (when (= surface i)
               (incf rate (* (aref values place) (if (< variable n) (aref rates variable) 1d0)))))
    rate))

(defun remove-surface-rate (surfaces i values rates)
  "Take from RATES what roundings have left of the rate of g of the surface I: they are to be tangent to it."
  (move-across-surface surfaces i values (- (surface-rate surfaces i values rates)) rates (length rates)))

(defun move-across-surface (surfaces i values way array n)
  "Change the first N numbers of ARRAY, by as little as possible, so that g of the surface I changes by WAY."
  (declare (type double-array values array))
  (let ((square 0d0))
    (declare (double-float square))
    (flet ((for-slopes (function)
             (loop for (surface . variable) in (surfaces-entries surfaces)
                   for place from (surfaces-count surfaces)
                   do (when (and (= surface i) (< variable n)) (funcall function variable (aref values place))))))
      (for-slopes (lambda (variable slope) (declare (ignore variable)) (incf square (* slope slope))))
      (when (plusp square)
        (for-slopes (lambda (variable slope) (incf (aref array variable) (/ (* slope way) square))))))
    array))
