;;; anmech: sums over the roots of a polynomial, Maxima's own 'lsum(f(%r), %r, rootsof(p(%r), %r)).
;;;
;;; With them answers stay in the field of the coefficients of p, whether or not its roots can be written down: exp(-A
;;; t) has the entries  lsum(q(%r) exp(-%r t), %r, rootsof(p)), q a polynomial.  Maxima displays such sums and leaves
;;; them alone; here is what the package needs of them.
;;;
;;;   Derivatives    under the sum; where p holds the variable, so do its roots: dr/dx = -(dp/dx)/(dp/dr).
;;;   Split form     what does not hold the root comes out of the sum, powers of the root are reduced modulo p, and sums
;;;                  of powers alone become rational by Newton's identities: a linear relation with coefficients free of
;;;                  the roots between sums over the same p holds if what is left are equal kernels.
;;;   Gathered form  the reverse, for what a person reads.
;;;   Values         with all roots at once, by Weierstrass' iteration; n times the last correction is the radius of a
;;;                  disc, and where the discs are disjoint there is one root in each.  So a value has a bound of its
;;;                  error.
;;;   Written out    real roots as floats, complex ones in pairs with cosines and sines: what compiled code and Maxima's
;;;                  own functions can work with.
;;;
;;; Entry points: ROOT-SUM-P, MAP-ROOT-SUMS, SPLIT-ROOT-SUM, POWER-AND-ARGUMENT, DERIVATIVE-OF-ROOT-SUM, ROOT-SUM-VALUE,
;;; ROOT-SUM-WRITTEN-OUT; anmech_root_sum, anmech_evident_root_sums, anmech_has_root_sums, anmech_split_root_sums,
;;; anmech_gathered_root_sums, anmech_written_out, anmech_modulo_polynomial, anmech_symbols_of; *ANGLE*.
;;;
;;; Literature: N. Jacobson, Basic Algebra I (1985), 2.13 (Newton's identities), 4.13 (symmetric functions); E. Durand,
;;; Solutions numeriques des equations algebriques I (1960); B. T. Smith, J. ACM 17 (1970) 661 (the discs).

(in-package :anmech)
(needs "session/scope" "session/texts" "arithmetic/approximate" "algebra/jets" "algebra/terms" "algebra/zero_test")

(defun root-sum-p (form)
  (and (operator-p form 'maxima::%lsum)
       (symbolp (third form))
       (operator-p (fourth form) 'maxima::$rootsof)
       (eq (third form) (third (fourth form)))))

(defun summand (form) (second form))
(defun summed-root (form) (third form))
(defun root-polynomial (form) (second (fourth form)))

(defun make-root-sum (summand root polynomial)
  "The sum of SUMMAND, its numerical factor before it."
  (cond ((eql summand 0) 0)
        ((and (operator-p summand 'maxima::mtimes) (maxima::mnump (second summand)))
         (product-of (second summand) (make-root-sum (apply #'product-of (cddr summand)) root polynomial)))
        ((maxima::$freeof root summand) (product-of (1- (length (coefficient-list polynomial root))) summand))
        (t (maxima::simplifya
            `((maxima::%lsum) ,summand ,root ((maxima::$rootsof maxima::simp) ,polynomial ,root)) nil))))

(defun map-root-sums (function form)
  "FORM with (FUNCTION sum) for every sum over roots in it."
  (cond ((atom form) form)
        ((root-sum-p form) (funcall function form))
        (t (with-arguments form (mapcar (lambda (part) (map-root-sums function part)) (rest form))))))

;;; Polynomials: lists of coefficients, the constant one first

(defun coefficient-list (polynomial variable)
  (let ((expanded (maxima::$expand polynomial)))
    (loop for k from 0 to (maxima::$hipow expanded variable)
          collect (maxima::$coeff expanded variable k))))

(defun rational-sum (a factor b)
  "A + FACTOR * B, canonical."
  (let ((sum (maxima::add a (maxima::mul factor b))))
    (if (atom sum) sum (maxima::$ratsimp sum))))

(defun remainder-modulo (coefficients modulus)
  "COEFFICIENTS, of any length, reduced to as many as the degree of MODULUS."
  (let* ((degree (1- (length modulus)))
         (reversed (reverse coefficients))
         (lead (first (last modulus)))
         (rule (mapcar (lambda (c) (rational-sum 0 -1 (maxima::div c lead))) (rest (reverse modulus)))))
    (loop while (> (length reversed) degree)
          do (let ((highest (pop reversed)))
               (unless (eql highest 0)
                 (loop for place on reversed
                       for c in rule
                       do (setf (first place) (rational-sum (first place) highest c))))))
    (nreverse reversed)))

(defun power-sums (modulus count)
  "The sums of the powers 0 to COUNT - 1 of the roots, by Newton's identities."
  (let* ((degree (1- (length modulus))) (lead (first (last modulus))) (sums (list degree)))
    (loop for k from 1 below count
          do (let ((sum 0))
               (loop for i from 1 to (min k degree)
                     for c = (maxima::div (nth (- degree i) modulus) lead)
                     do (setq sum (rational-sum sum -1 (maxima::mul c (if (= i k) k (nth (1- i) sums))))))
               (push sum sums)))
    (nreverse sums)))

;;; Derivatives

(defun derivative-of-root-sum (form rate)
  "The derivative in the direction RATE, as for derivative-along."
  (let ((root (summed-root form)) (polynomial (root-polynomial form)))
    (labels ((along (form slope)
               (derivative-along form (lambda (symbol) (if (eq symbol root) slope (funcall rate symbol))))))
      (let ((drift (along polynomial 0)))
        (make-root-sum (along (summand form)
                              (if (eql drift 0) 0 (maxima::neg (maxima::div drift (maxima::sdiff polynomial root)))))
                       root polynomial)))))

(defun derivative-of-sum (form rate)
  (if (root-sum-p form) (derivative-of-root-sum form rate) (derivative-of-function form rate)))

(setf (get 'maxima::%lsum 'derivative-rule) 'derivative-of-sum)

;;; The split form

(defun split-term (term root)
  "The factor of TERM free of ROOT, the power of ROOT, and what else holds it."
  (let ((outside '()) (power 0) (inside '()))
    (dolist (factor (if (operator-p term 'maxima::mtimes) (rest term) (list term)))
      (cond ((maxima::$freeof root factor) (push factor outside))
            ((eq factor root) (incf power))
            ((and (operator-p factor 'maxima::mexpt) (eq root (second factor)) (typep (third factor) '(integer 0)))
             (incf power (third factor)))
            ((and (operator-p factor 'maxima::mexpt) (operator-p (third factor) 'maxima::mplus)
                  (maxima::$freeof root (second factor)))
             (destructuring-bind (base exponent) (rest factor)
               (let ((free (remove-if-not (lambda (part) (maxima::$freeof root part)) (rest exponent))))
                 (push (power-of base (sum-of free)) outside)
                 (push (power-of base (maxima::sub exponent (sum-of free))) inside))))
            (t (push factor inside))))
    (values (apply #'product-of outside) power (apply #'product-of inside))))

(defun root-sum-terms (form)
  "A list of pairs (cofactor . sum over roots or 1) that add up to FORM; nil if it is not linear in such sums."
  (let* ((names '())
         (named (map-root-sums (lambda (sum)
                                 (or (cdr (assoc sum names :test #'maxima::alike1))
                                     (cdar (push (cons sum (maxima::$gensym)) names))))
                               form))
         (rest (maxima::$expand named))
         (terms (loop for (sum . name) in names
                      for cofactor = (maxima::$coeff rest name)
                      do (setq rest (maxima::$expand (maxima::sub rest (maxima::mul name cofactor))))
                      collect (cons cofactor sum))))
    (and (loop for (nil . name) in names
               always (maxima::$freeof name (maxima-list (cons rest (mapcar #'car terms)))))
         (cons (cons rest 1) terms))))

(defun gathered-root-sums (form)
  "FORM, where it is linear in sums over roots, with one of them for all that differ by factors and powers of the root."
  (let ((terms (and (root-sum-terms form) (root-sum-terms (map-root-sums #'split-root-sum form))))
        (groups '()) (others '()))      ; lists (root-sum inside (power of the root . coefficient) ...)
    (loop for (cofactor . sum) in terms
          do (if (or (eql sum 1) (not (maxima::$freeof (summed-root sum) cofactor)))
                 (push (product-of cofactor sum) others)
                 (multiple-value-bind (outside power inside) (split-term (summand sum) (summed-root sum))
                   (let ((group (or (find-if (lambda (group)
                                               (and (maxima::alike1 (second group) inside)
                                                    (same-roots-p (first group) sum)))
                                             groups)
                                    (first (push (list sum inside) groups)))))
                     (push (cons power (maxima::mul cofactor outside)) (cddr group))))))
    (if terms (sum-of (append others (mapcar #'gathered-sum groups))) form)))

(defun same-roots-p (a b)
  (and (eq (summed-root a) (summed-root b))
       (maxima::alike1 (maxima::$expand (root-polynomial a)) (maxima::$expand (root-polynomial b)))))

(defun gathered-sum (group)
  (destructuring-bind (sum inside . terms) group
    (let ((root (summed-root sum)))
      (make-root-sum (product-of (maxima::$factor (sum-of (loop for (power . factor) in terms
                                                                collect (product-of factor (power-of root power)))))
                                 inside)
                     root (maxima::$expand (root-polynomial sum))))))

(defun power-and-argument (form)
  "n and u if FORM is the sum of r^n exp(r u) over roots r, u free of r; else nil."
  (let ((root (summed-root form)))
    (multiple-value-bind (outside power inside) (split-term (summand form) root)
      (when (and (eql outside 1) (operator-p inside 'maxima::mexpt) (maxima::$freeof root (second inside)))
        (destructuring-bind (base exponent) (rest inside)
          (let ((u (maxima::mul (maxima::div exponent root)
                                (if (eq base 'maxima::$%e) 1 (maxima::simplify `((maxima::%log) ,base))))))
            (when (maxima::$freeof root u) (values power u))))))))

(defun split-root-sum (form)
  (let* ((root (summed-root form)) (polynomial (root-polynomial form)) (modulus (coefficient-list polynomial root))
         (expanded (maxima::$expand (map-root-sums #'split-root-sum (summand form))))
         (groups '()))                  ; lists (inside (power . factor outside) ...)
    (dolist (term (if (operator-p expanded 'maxima::mplus) (rest expanded) (list expanded)))
      (multiple-value-bind (outside power inside) (split-term term root)
        (let ((group (or (assoc inside groups :test #'maxima::alike1) (first (push (list inside) groups)))))
          (push (cons power outside) (rest group)))))
    (sum-of (loop for (inside . terms) in groups collect (sum-of-group inside terms root polynomial modulus)))))

(defun sum-of-group (inside terms root polynomial modulus)
  "The sum over the roots of INSIDE times the sum of TERMS, pairs of a power of ROOT and its coefficient."
  (let ((coefficients (make-list (1+ (reduce #'max terms :key #'car)) :initial-element 0)))
    (loop for (power . factor) in terms
          do (setf (nth power coefficients) (maxima::add factor (nth power coefficients))))
    (if (eql inside 1)
        (sum-of (mapcar #'product-of coefficients (power-sums modulus (length coefficients))))
        (sum-of (loop for factor in (remainder-modulo coefficients modulus)
                      for power from 0
                      unless (eql factor 0)
                        collect (product-of factor (make-root-sum (product-of (power-of root power) inside)
                                                                  root polynomial)))))))

;;; Roots in numbers

(defun polynomial-value (coefficients z)
  (let ((value 0))
    (dolist (c (reverse coefficients) value) (setq value (+ c (* z value))))))

(defun weierstrass-correction (coefficients value place roots)
  "VALUE over the derivative that the polynomial would have at the first root of PLACE, a tail of ROOTS, if the others
were right."
  (let ((slope (first (last coefficients))))
    (loop for other on roots
          unless (eq other place) do (setq slope (* slope (- (first place) (first other)))))
    (/ value slope)))

(defun numeric-roots (coefficients)
  "The roots of a polynomial of doubles, complex numbers; they are not checked."
  (let* ((degree (1- (length coefficients)))
         (lead (first (last coefficients)))
         (middle (/ (nth (1- degree) coefficients) (* -1d0 degree lead)))
         (radius (loop for k from 1 to degree
                       maximize (expt (abs (/ (nth (- degree k) coefficients) lead)) (/ 1d0 k))))
         (roots (loop for k below degree
                      collect (+ middle (* radius (cis (+ 0.4d0 (/ (* 2 pi k) degree))))))))
    (if (zerop radius)
        (make-list degree :initial-element #c(0d0 0d0))
        (loop with before = most-positive-double-float
              repeat 500
              do (let ((change 0d0))
                   (loop for place on roots
                         do (let ((step (weierstrass-correction
                                         coefficients (polynomial-value coefficients (first place)) place roots)))
                              (setf (first place) (- (first place) step)
                                    change (max change (abs step)))))
                   (when (and (<= before change) (< change (* 1d-8 radius))) (return roots))
                   (setq before change))
              finally (return roots)))))

(defun roots-with-bounds (coefficients)
  "Approximate numbers, one for each root of the polynomial with approximate COEFFICIENTS; undecided where two of them
cannot be told apart."
  (let* ((numbers (mapcar #'car coefficients))
         (roots (numeric-roots numbers))
         (discs (loop for place on roots
                      for z = (cons (first place) 0d0)
                      for value = (reduce (lambda (value c) (add-approximate c (multiply-approximate z value)))
                                          (reverse coefficients) :initial-value (cons 0d0 0d0))
                      for step = (weierstrass-correction numbers (+ (abs (car value)) (cdr value)) place roots)
                      collect (cons (first place) (* (length roots) (abs step))))))
    (loop for ((z . radius) . others) on discs
          do (loop for (other . other-radius) in others
                   do (unless (> (abs (- z other)) (* 2 (+ radius other-radius))) (undecided))))
    discs))

(defvar *known-roots* '() "The roots of the last polynomials: pairs of approximate coefficients and approximate roots.")

(defun approximate-roots (polynomial root)
  "The roots of POLYNOMIAL at the present point."
  (let ((coefficients (mapcar #'point-value (coefficient-list polynomial root))))
    (unless (certainly-nonzero-p (first (last coefficients))) (undecided))
    (cdr (or (assoc coefficients *known-roots* :test #'equal)
             (first (setq *known-roots*
                          (cons (cons coefficients (roots-with-bounds coefficients))
                                (subseq *known-roots* 0 (min 8 (length *known-roots*))))))))))

(defun root-sum-value (form)
  "FORM at the present point, (value . bound)."
  (let ((sum (cons 0d0 0d0)))
    (dolist (root (approximate-roots (root-polynomial form) (summed-root form)) (almost-real sum))
      (let ((*bound-values* (acons (summed-root form) root *bound-values*)))
        (setq sum (add-approximate sum (point-value (summand form))))))))

(setf (get 'maxima::%lsum 'point-value) (lambda (form) (if (root-sum-p form) (root-sum-value form) (undecided))))

;;; Written out with numbers for the roots

(defun real-coefficients (polynomial root)
  "The doubles next to the coefficients, or nil if there are others than numbers."
  (let ((numbers (mapcar #'maxima::$float (coefficient-list polynomial root))))
    (and (every #'floatp numbers) numbers)))

(defvar *angle* (if (get 'maxima::%atan2 'maxima::operators) 'maxima::%atan2 'maxima::$atan2)
  "What this Maxima calls the angle of two coordinates.")

(defun complex-parts (form root a b)
  "The real and the imaginary part of FORM for ROOT = A + %i B, all else in it being real."
  (labels ((parts (form)
             (cond ((eq form root) (values a b))
                   ((maxima::$freeof root form) (values form 0))
                   (t (case (caar form)
                        (maxima::mplus (combined #'add '(0 . 0) (rest form)))
                        (maxima::mtimes (combined #'multiply '(1 . 0) (rest form)))
                        (maxima::mexpt (power (second form) (third form)))
                        (maxima::%log (logarithm (second form)))
                        (t (refuse))))))
           (combined (operation start forms)
             (let ((value start))
               (dolist (form forms (values (car value) (cdr value)))
                 (setq value (multiple-value-bind (x y) (parts form) (funcall operation value (cons x y)))))))
           (add (u v) (cons (maxima::add (car u) (car v)) (maxima::add (cdr u) (cdr v))))
           (multiply (u v)
             (cons (maxima::sub (maxima::mul (car u) (car v)) (maxima::mul (cdr u) (cdr v)))
                   (maxima::add (maxima::mul (car u) (cdr v)) (maxima::mul (cdr u) (car v)))))
           (power (base exponent)
             (cond ((eq base 'maxima::$%e)
                    (multiple-value-bind (x y) (parts exponent)
                      (let ((size (power-of 'maxima::$%e x)))
                        (values (product-of size (function-of 'maxima::%cos y))
                                (product-of size (function-of 'maxima::%sin y))))))
                   ((not (integerp exponent)) (refuse))
                   ((plusp exponent) (combined #'multiply '(1 . 0) (make-list exponent :initial-element base)))
                   (t (multiple-value-bind (x y) (power base (- exponent))
                        (let ((square (maxima::add (maxima::mul x x) (maxima::mul y y))))
                          (values (maxima::div x square) (maxima::neg (maxima::div y square))))))))
           (logarithm (argument)
             (multiple-value-bind (x y) (parts argument)
               (values (maxima::div (function-of 'maxima::%log (maxima::add (maxima::mul x x) (maxima::mul y y))) 2)
                       (maxima::simplify (list (list *angle*) y x)))))
           (refuse ()
             (complain "the sum of ~a over complex roots cannot be written in real functions" (one-line form))))
    (parts form)))

(defun root-sum-written-out (form)
  "FORM with floats for the roots, or nil if the coefficients of its polynomial are not all numbers."
  (let* ((root (summed-root form))
         (coefficients (real-coefficients (root-polynomial form) root)))
    (when coefficients
      (sum-of
       (loop for z in (numeric-roots coefficients)
             if (<= (abs (imagpart z)) (* 1d-12 (abs z)))
               collect (maxima::$substitute (realpart z) root (summand form))
             else if (plusp (imagpart z))
               collect (product-of 2 (complex-parts (summand form) root (realpart z) (imagpart z))))))))

;;; The thin layer

(maxima::defmfun maxima::$anmech_root_sum (summand root polynomial)
  "anmech_root_sum(f, r, p): the sum of f over the roots r of p."
  (make-root-sum summand root polynomial))

(maxima::defmfun maxima::$anmech_evident_root_sums (form)
  "anmech_evident_root_sums(expr): without sums of what has become 0, or free of the root."
  (map-root-sums (lambda (sum) (make-root-sum (summand sum) (summed-root sum) (root-polynomial sum))) form))

(maxima::defmfun maxima::$anmech_has_root_sums (form)
  "anmech_has_root_sums(expr): whether a sum over roots occurs."
  (and (some-part #'root-sum-p form) t))

(maxima::defmfun maxima::$anmech_split_root_sums (form)
  "anmech_split_root_sums(expr): linear relations between sums over roots become relations between kernels."
  (map-root-sums #'split-root-sum form))

(defun written-out (form)
  "FORM with floats for the roots that sums run over, where they are known; derivatives of such sums are taken."
  (cond ((atom form) form)
        ((root-sum-p form) (or (root-sum-written-out form) form))
        ((and (eq (caar form) 'maxima::%derivative) (some-part #'root-sum-p (second form)))
         (apply #'maxima::$diff (written-out (second form)) (cddr form)))
        (t (with-arguments form (mapcar #'written-out (rest form))))))

(maxima::defmfun maxima::$anmech_written_out (form)
  "anmech_written_out(expr): with floats for the roots that sums run over, where they are known."
  (written-out form))

(maxima::defmfun maxima::$anmech_gathered_root_sums (form)
  "anmech_gathered_root_sums(expr): what differs by powers of the same roots and by factors, in one sum."
  (gathered-root-sums form))

(maxima::defmfun maxima::$anmech_modulo_polynomial (form polynomial variable)
  "anmech_modulo_polynomial(expr, p, r): the remainder of expr, a polynomial in r."
  (sum-of (loop for c in (remainder-modulo (coefficient-list form variable) (coefficient-list polynomial variable))
                for k from 0
                collect (product-of (if (maxima::mnump c) c (maxima::$ratsimp c)) (power-of variable k)))))

(maxima::defmfun maxima::$anmech_symbols_of (form)
  "anmech_symbols_of(expr): listofvars, with symbols that are declared constant, without the roots that sums run over."
  (let ((roots '()) (maxima::$listconstvars t))
    (some-part (lambda (part) (when (root-sum-p part) (pushnew (summed-root part) roots)) nil) form)
    (maxima-list (remove-if (lambda (symbol)
                              (or (member symbol roots) (and (symbolp symbol) (get symbol 'maxima::sysconst))))
                            (rest (maxima::$listofvars form))))))
