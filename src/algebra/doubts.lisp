;;; anmech: whether what residues say of expressions is proved.
;;;
;;; Of what a reader has read (nodes.lisp): between the kernels there may be relations that the residues do not respect,
;;; or that hold on one branch only.
;;;
;;; Entry points: DOUBTFUL-P, anmech_is_doubtful.
;;;
;;; Literature: A. Baker, Transcendental Number Theory (1975), 1.3, for the theorem of Lindemann and Weierstrass.

(in-package :anmech)
(needs "session/scope" "session/texts" "arithmetic/residues" "algebra/constants" "algebra/nodes"
       "algebra/terms")

(defun doubtful-p ()
  (or (nested-bases-p) (doubtful-numbers-p) (undecided-branches-p (reader-radicands *reader*))
      (undecided-branches-p (mapcar (lambda (form) (cons form nil)) (reader-logarithms *reader*)))))

(maxima::defmfun maxima::$anmech_is_doubtful (forms)
  "anmech_is_doubtful([e, ...]): whether relations between the kernels of the e may be missed, or hold on one branch
only; also where that cannot be told."
  (handler-case
      (with-maxima-errors
        (call-with-reader '() '() (rest forms)
                          (lambda ()
                            (mapc #'coefficient-node (rest forms))
                            (settle-exponentials)
                            (and (doubtful-p) t))))
    (maxima::maxima-$error () t)))

(defun nested-bases-p ()
  "Whether a root or a logarithm was taken of something with roots in it: between such, relations may be missed."
  (some (lambda (base) (some-part #'root-p (base-form base))) (reader-bases *reader*)))

;;; Numbers

(defun doubtful-numbers-p ()
  "Whether numbers occur that are not known to be independent: one is transcendental, or all are exponentials of
algebraic numbers."
  (let* ((exponents (remove-if-not #'constant-form-p (reader-exponents *reader*)))
         (others (remove-if #'algebraic-form-p exponents))
         (count (+ (length others) (length (numbers-with-logarithms)) (if (symbol-read-p 'maxima::$%pi) 1 0))))
    (or (symbol-read-p 'maxima::$%gamma)
        (symbol-read-p 'maxima::$%catalan)
        (some #'unit-exponent-p others)
        (> count 1)
        (and (= count 1) (set-difference exponents others)))))

(defun symbol-read-p (symbol)
  (gethash symbol (reader-nodes *reader*)))

(defun numbers-with-logarithms ()
  (remove-duplicates
   (loop for form in (reader-logarithms *reader*)
         append (loop for (factor) in (factors-of form)
                      when (and (as-number factor) (not (eql factor -1))) collect factor))))

(defun unit-exponent-p (exponent)
  "Whether exp(EXPONENT) is a root of unity, of an order that the primes do not have."
  (multiple-value-call #'turns (split-number exponent)))

;;; Branches.  Roots, and logarithms, of products of the same factors depend on each other up to a branch.

(defun undecided-branches-p (radicands)
  "RADICANDS: an alist from forms to the orders of the roots that were taken of them, nil for logarithms.  Roots are
independent if for each prime the multiplicities are, of those whose orders it divides."
  (let* ((rows (multiplicities (mapcar #'car radicands))) (orders (mapcar #'cdr radicands)))
    (flet ((dependent-p (test prime)
             (dependent-rows-p
              (loop for row in rows for order in orders when (and row (funcall test order)) collect row) prime)))
      (or (dependent-p #'null (suitable-prime 0))
          (some (lambda (prime) (dependent-p (lambda (order) (and order (= 0 (mod order prime)))) prime))
                (prime-divisors (reduce #'lcm (remove nil orders) :initial-value 1)))))))

(defun multiplicities (forms)
  "For each of FORMS the multiplicities of all branching factors in it; nil where it has none."
  (let* ((factors (mapcar #'branching-factors forms))
         (bases (remove-duplicates (mapcar #'car (apply #'append factors)) :test #'maxima::alike1)))
    (loop for own in factors
          collect (and own (loop for base in bases collect (or (cdr (assoc base own :test #'maxima::alike1)) 0))))))

(defun branching-factors (form)
  "The factors of FORM but those whose roots and logarithms have a usual branch: those that are positive or zero, and
exponentials."
  (remove-if (lambda (factor)
               (or (as-number (car factor)) (operator-p (car factor) 'maxima::mexpt)
                   (member (maxima::$csign (car factor)) '(maxima::$pos maxima::$pz))))
             (factors-of form)))

(defun dependent-rows-p (rows prime)
  "Whether ROWS, lists of rational numbers, are linearly dependent modulo PRIME; also where that is not known."
  (let ((pivots '()) (*prime* prime))
    (dolist (row rows nil)
      (unless (every (lambda (number) (plusp (mod (denominator number) prime))) row) (return t))
      (let ((row (mapcar #'number-residue row)))
        (loop for (place . pivot) in (reverse pivots)
              do (let ((factor (nth place row)))
                   (setq row (mapcar (lambda (a b) (mod (- a (* factor b)) prime)) row pivot))))
        (let ((place (position-if #'plusp row)))
          (unless place (return t))
          (let ((inverse (inverse-modulo (nth place row) prime)))
            (push (cons place (mapcar (lambda (a) (mod (* a inverse) prime)) row)) pivots)))))))
