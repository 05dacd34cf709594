;;; anmech: linear relations between functions, with constant coefficients.
;;;
;;; An ansatz leads to the question which constants c_j make  sum_j c_j e_j = 0  hold identically in some variables, the
;;; e_j being lists of known expressions.  First the e_j are evaluated at random points modulo a prime (nodes.lisp):
;;; what is independent there is so, without any symbolic work; the few columns that can take part in a relation are
;;; left.  These are split into monomials in what depends on the variables (x, sin(x), %e^(k*t), ...), and the
;;; coefficients of each monomial give one equation between the c_j over the field of the parameters, which are solved
;;; exactly (sparse.lisp).
;;;
;;; In the second step functions such as x and log(x) count as independent; what is used are the addition theorems of
;;; sine and cosine, their squares, that other circular and hyperbolic functions are made of them and of exponentials,
;;; the chain rule for undefined functions, and r^n = p for the roots r = p^(1/n).  A relation that is found holds in
;;; any case; one that rests on a hidden dependence may be missed.  For parameters the answer is the generic one.
;;; Where the c_j are rational numbers the first step shows them already, without a proof.
;;;
;;; Entry points: anmech_relations, anmech_seeming_relations, anmech_spanning, anmech_independent_lists,
;;; anmech_equations_without, anmech_pivots; CALL-AT-RANDOM-POINT, POLYNOMIALS-OF.

(in-package :anmech)
(needs "session/patience" "session/scope" "session/texts" "arithmetic/polynomials" "arithmetic/residues"
       "arithmetic/series" "algebra/jets" "algebra/linear_solutions" "algebra/nodes" "algebra/rootsums" "algebra/sparse"
       "algebra/terms")

;;; Splitting into monomials

(defstruct (piece (:type list))
  "A number times powers of parameters: part of the coefficient of the unknown of number COLUMN in a ROW of equations."
  row column factor powers)

(defun replaced-functions (form rule)
  "FORM, every operator form u in it for which (funcall RULE u) is not nil replaced by that."
  (if (atom form)
      form
      (or (funcall rule form)
          (let ((parts (mapcar (lambda (part) (replaced-functions part rule)) (rest form))))
            (if (every #'eq parts (rest form)) form (with-arguments form parts))))))

(defun in-elementary-functions (form)
  "FORM with sines, cosines and exponentials for tangents, hyperbolic functions and the like."
  (labels ((elementary (part)
             (let ((u (and (rest part) (in-elementary-functions (second part)))))
               (flet ((ratio (above below) (maxima::div (function-of above u) (function-of below u)))
                      (over (below) (maxima::div 1 (function-of below u)))
                      (exponentials (sign)
                        (maxima::div (maxima::add (power-of 'maxima::$%e u)
                                                  (maxima::mul sign (power-of 'maxima::$%e (maxima::neg u))))
                                     2)))
                 (case (caar part)
                   (maxima::%tan (ratio 'maxima::%sin 'maxima::%cos))
                   (maxima::%cot (ratio 'maxima::%cos 'maxima::%sin))
                   (maxima::%sec (over 'maxima::%cos))
                   (maxima::%csc (over 'maxima::%sin))
                   (maxima::%sinh (exponentials -1))
                   (maxima::%cosh (exponentials 1))
                   (maxima::%tanh (maxima::div (exponentials -1) (exponentials 1)))
                   (maxima::%coth (maxima::div (exponentials 1) (exponentials -1))))))))
    (replaced-functions form #'elementary)))

(defun angle-parts (angle)
  "ANGLE as an alist of its monomials and their rational factors."
  (let ((expanded (maxima::$expand angle)))
    (loop for term in (if (operator-p expanded 'maxima::mplus) (rest expanded) (list expanded))
          for factor = (as-rational (maxima::$numfactor term))
          when (rationalp factor)
            collect (cons (maxima::div term (as-form factor)) factor)
          else collect (cons term 1))))

(defun with-common-angles (forms)
  "FORMS with the sines and cosines of all angles in terms of those of as few as there can be: x/6 for x/2,
x/3 and x + y."
  (let* ((angles (rest (maxima::$anmech_arguments_of (maxima-list forms) '((maxima::mlist) maxima::$sin maxima::$cos))))
         (parts (mapcar (lambda (angle) (cons angle (angle-parts angle))) angles))
         (names '()))
    (if (or (null (rest angles)) (independent-angles-p parts))
        forms
        (progn
          (loop for (nil . terms) in parts
                do (loop for (monomial . factor) in terms
                         for entry = (or (assoc monomial names :test #'maxima::alike1)
                                         (first (push (list monomial (maxima::$gensym) 1) names)))
                         do (setf (third entry) (lcm (third entry) (denominator factor)))))
          (mapcar (lambda (form) (in-named-angles form parts names)) forms)))))

(defun independent-angles-p (parts)
  (let ((monomials (loop for (nil . terms) in parts append (mapcar #'car terms))))
    (= (length monomials) (length (remove-duplicates monomials :test #'maxima::alike1)))))

(defun in-named-angles (form parts names)
  (flet ((expanded (part)
           (let ((terms (and (member (caar part) '(maxima::%sin maxima::%cos))
                             (cdr (assoc (second part) parts :test #'maxima::alike1)))))
             (when terms
               (let ((maxima::$trigexpand t)
                     (angle (sum-of (loop for (monomial . factor) in terms
                                          for (nil name count) = (assoc monomial names :test #'maxima::alike1)
                                          collect (maxima::mul (* count factor) name)))))
                 (maxima::$trigexpand (function-of (caar part) angle)))))))
    (let ((result (replaced-functions form #'expanded)))
      (loop for (monomial name count) in names
            do (setq result (maxima::$substitute (maxima::div monomial count) name result)))
      result)))

(defun in-sines (form)
  "FORM, even powers of cosines replaced by sines."
  (dolist (u (rest (maxima::$anmech_arguments_of form '((maxima::mlist) maxima::$cos))) form)
    (setq form (maxima::$ratsubst (maxima::sub 1 (power-of (function-of 'maxima::%sin u) 2))
                                  (power-of (function-of 'maxima::%cos u) 2)
                                  form))))

(defun number-before (form)
  "The positive rational number, and the polynomial with coprime integers for coefficients, whose product FORM is; 1 and
FORM if it is no polynomial."
  (let ((rational (maxima::$rat form)) (content 0))
    (cond ((not (integerp (cddr rational))) (values 1 form))
          (t (map-terms (lambda (factor powers) (declare (ignore powers)) (setq content (gcd content factor)))
                        (second rational) '())
             (let ((number (/ content (cddr rational))))
               (if (member number '(0 1))
                   (values 1 form)
                   (values number (maxima::$ratsimp (maxima::div form (as-form number))))))))))

(defun with-plain-roots (forms)
  "FORMS with what is under roots multiplied out, without a number before it: of (x-1)^2 + y^2 and x^2/4 - x/2 + 1/4 +
y^2/4 it is one root."
  (let ((known '()))
    (labels ((plain-base (base)
               (let ((entry (assoc base known :test #'equal)))
                 (if entry
                     (cdr entry)
                     (let ((plain (maxima::$ratsimp (plain base))))
                       (push (cons base plain) known)
                       plain))))
             (plain (form)
               (cond ((atom form) form)
                     ((root-p form)
                      (multiple-value-bind (number base) (number-before (plain-base (second form)))
                        (product-of (power-of (as-form number) (third form)) (power-of base (third form)))))
                     (t (with-arguments form (mapcar #'plain (rest form)))))))
      (mapcar #'plain forms))))

(defun roots-of (forms)
  "A list of (base degree name) for the roots in FORMS, degree the least common one; a base before those that occur in
it."
  (let ((found '()))
    (some-part (lambda (part)
                 (when (root-p part)
                   (let ((root (or (assoc (second part) found :test #'maxima::alike1)
                                   (first (push (list (second part) 1 (maxima::$gensym)) found)))))
                     (setf (second root) (lcm (second root) (third (third part))))))
                 nil)
               (cons '(maxima::mlist) forms))
    (sort found #'> :key (lambda (root) (maxima::$anmech_size (first root))))))

(defun with-named-roots (form roots)
  "FORM with powers of the names for the fractional powers."
  (if (or (null roots) (atom form))
      form
      (let ((root (and (root-p form) (assoc (second form) roots :test #'maxima::alike1))))
        (if root
            (power-of (third root) (* (second root) (as-rational (third form))))
            (with-arguments form (mapcar (lambda (part) (with-named-roots part roots)) (rest form)))))))

(defun in-roots (form roots)
  "FORM, a polynomial in the names r of roots p^(1/n), with p for r^n, and without names."
  (loop for (base degree name) in roots
        do (setq form (maxima::$ratsubst (with-named-roots base roots) (power-of name degree) form)))
  (loop for (base degree name) in roots
        do (setq form (maxima::$substitute (power-of base (as-form (/ 1 degree))) name form)))
  form)

(defun common-multiple (a b)
  (poll)
  (if (eql b 1) a (maxima::$ratsimp (maxima::div (maxima::mul a b) (maxima::$gcd a b)))))

(defun polynomials-of (forms)
  "FORMS times a common denominator, as canonical rational forms with numbers for denominators."
  (let* ((forms (with-common-angles (mapcar (lambda (form)
                                              (map-root-sums #'split-root-sum
                                                             (in-elementary-functions
                                                              (without-second-slopes (along-one-jet form)))))
                                            forms)))
         (forms (with-plain-roots forms))
         (roots (roots-of forms))
         (forms (mapcar (lambda (form) (poll) (maxima::$ratsimp (with-named-roots form roots))) forms))
         (multiple (reduce #'common-multiple (mapcar #'maxima::$denom forms) :initial-value 1)))
    (flet ((cleared (form)
             (poll)
             (maxima::$rat (in-sines (in-roots (maxima::$ratsimp (maxima::mul form multiple)) roots)))))
      (let ((cleared (mapcar #'cleared forms)))
        (if (every (lambda (rational) (numberp (cddr rational))) cleared)
            cleared
            (polynomials-of (mapcar #'maxima::$ratdisrep cleared)))))))

(defun depends-p (kernel variables)
  (notevery (lambda (variable) (maxima::$freeof variable kernel)) variables))

(defun map-terms (function polynomial powers)
  "Call FUNCTION with the integer and the powers, an alist by generator, of every term of a canonical POLYNOMIAL."
  (if (atom polynomial)
      (unless (eql polynomial 0) (funcall function polynomial powers))
      (loop for (exponent coefficient) on (rest polynomial) by #'cddr
            do (map-terms function coefficient
                          (if (eql exponent 0) powers (acons (first polynomial) exponent powers))))))

(defun pieces-of (rational component column variables)
  "The pieces of RATIONAL; a row is named by COMPONENT and a monomial in the variables."
  (let ((kernels (loop for kernel in (third (first rational))
                       for generator in (fourth (first rational)) collect (cons generator kernel)))
        (pieces '()))
    (poll)
    (map-terms
     (lambda (factor powers)
       (let ((powers (loop for (generator . exponent) in powers
                           collect (cons (cdr (assoc generator kernels)) exponent))))
         (push (make-piece
                :row (cons component (sort (loop for (kernel . exponent) in powers
                                                 when (depends-p kernel variables)
                                                   collect (format nil "~s ~d" (form-without-flags kernel) exponent))
                                           #'string<))
                :column column
                :factor (/ factor (cddr rational))
                :powers (remove-if (lambda (power) (depends-p (car power) variables)) powers))
               pieces)))
     (second rational) '())
    pieces))

(defun form-without-flags (form)
  "FORM without Maxima's flags, so that equal kernels print alike."
  (if (consp form)
      (cons (caar form) (mapcar #'form-without-flags (rest form)))
      form))

(defun equations-between (columns variables)
  "Rows of pieces: for all c_j, sum c_j e_j = 0 iff each row vanishes."
  (let ((rows (make-hash-table :test #'equal)))
    (dotimes (component (length (rest (first columns))))
      (poll)
      (loop for polynomial in (polynomials-of (mapcar (lambda (column) (nth component (rest column))) columns))
            for column from 0
            do (dolist (piece (pieces-of polynomial component column variables))
                 (push piece (gethash (piece-row piece) rows)))))
    (sort (loop for row being the hash-values of rows collect row) #'< :key #'length)))

;;; Columns that can take part in a relation

(defun call-at-random-point (forms variables thunk)
  "THUNK at a point where parameters have random residues; those of the VARIABLES change from sample to sample.  nil if
FORMS hold something of which there are no residues."
  (first (call-at-random-points 1 forms variables (lambda () (list '()))
                                (lambda (nothing) (declare (ignore nothing)) (funcall thunk)))))

(defun call-at-random-points (count forms variables prepare thunk)
  "The values at COUNT points of THUNK, called with that of PREPARE, which is called once, to read nodes.  Each attempt
has a prime of its own: modulo one without a cube root of 2 there is none at any point."
  (handler-case
      (with-maxima-errors
        (call-with-reader
         '() variables forms
         (lambda ()
           (let* ((monomials (monomials-up-to 1 0)) (*root-sums-linear* t) (prepared (funcall prepare)) (results '()))
             (loop for seed from 1 to 200
                   while (< (length results) count)
                   do (let ((result (at-point (new-point seed (suitable-prime (1- seed))) monomials
                                              (lambda () (funcall thunk prepared)))))
                        (unless (eq result :left) (push result results))))
             (and (= (length results) count) (nreverse results))))))
    (maxima::maxima-$error () nil)))

(defun value-rows (columns)
  "For each component the row of the residues of COLUMNS, lists of nodes."
  (loop for component below (length (first columns))
        collect (loop for nodes in columns
                      for column from 0
                      for residue = (constant-part (series-of (nth component nodes)))
                      unless (= 0 residue) collect (cons column residue))))

(defun value-echelon (columns)
  "The rows of COLUMNS at so many samples that two more add nothing."
  (dolist (column columns) (mapc #'visit-fixed-part column))
  (let ((echelon (new-echelon (length columns))) (idle 0))
    (loop for attempt from 0
          until (= idle 2)
          do (when (> attempt 2000) (leave-point))
             (let ((grown (catch 'point
                            (at-sample (make-hash-table :test #'eq)
                                       (lambda ()
                                         (count-if (lambda (row) (insert-row row echelon 0)) (value-rows columns)))))))
               (cond ((eq grown :left))
                     ((= 0 grown) (incf idle))
                     (t (setq idle 0)))))
    echelon))

(defun echelons-of-columns (count columns variables)
  "COUNT echelons of the values of COLUMNS, lists of forms, modulo different primes; nil where there are no residues of
them."
  (call-at-random-points
   count (loop for column in columns append column) variables
   (lambda ()
     (prog1 (mapcar (lambda (column) (mapcar #'coefficient-node column)) columns)
       (settle-exponentials)))
   #'value-echelon))

(defun echelon-of-columns (columns variables)
  (first (echelons-of-columns 1 columns variables)))

(defun columns-to-look-at (columns variables)
  "The numbers of those of COLUMNS, lists of forms, that take part in a relation modulo a prime; all where that is not
known."
  (let ((echelon (echelon-of-columns columns variables)))
    (if echelon
        (occurring-columns echelon)
        (loop for column below (length columns) collect column))))

;;; Rows that matter

(defun residue-row (pieces)
  (flet ((value-of (kernel) (constant-part (series-of (coefficient-node kernel)))))
    (loop for piece in pieces
          collect (cons (piece-column piece)
                        (let ((value (number-residue (piece-factor piece))))
                          (loop for (kernel . exponent) in (piece-powers piece)
                                do (setq value (mod (* value (power-residue (value-of kernel) exponent)) *prime*)))
                          value)))))

(defun independent-rows (rows count)
  "Those of ROWS, lists of pieces, that are independent at random values of the parameters."
  (let ((kernels (loop for row in rows
                       append (loop for piece in row append (mapcar #'car (piece-powers piece))))))
    (or (call-at-random-point
         kernels '()
         (lambda ()
           (let ((echelon (new-echelon count)))
             (mapc #'coefficient-node kernels)
             (settle-exponentials)
             (remove-if-not (lambda (row) (insert-row (residue-row row) echelon 0)) rows))))
        rows)))

(defun exact-row (pieces)
  (poll)
  (let ((row '()))
    (dolist (piece pieces)
      (let ((column (piece-column piece)))
        (push (piece-value piece) (cdr (or (assoc column row) (first (push (list column) row)))))))
    (sort (loop for (column . terms) in row
                for value = (as-rational (maxima::$ratsimp (sum-of terms)))
                unless (eql value 0) collect (cons column value))
          #'< :key #'car)))

(defun piece-value (piece)
  (apply #'product-of (as-form (piece-factor piece))
         (loop for (kernel . exponent) in (piece-powers piece) collect (power-of kernel exponent))))

;;; Entry points

(defun exact-relations (columns variables)
  (let ((maxima::$algebraic (and (roots-of (loop for column in columns append column)) t)) (count (length columns)))
    (null-vectors (mapcar #'exact-row
                          (independent-rows (equations-between (mapcar #'maxima-list columns) variables) count))
                  count)))

(maxima::defmfun maxima::$anmech_relations (columns variables)
  "anmech_relations([[e_11, e_12, ..], [e_21, ..], ..], [x, ..]): a basis of the lists c, free of the variables, with
sum_j c_j e_jk = 0 for every k, identically in the variables."
  (let* ((columns (mapcar #'rest (rest columns)))
         (places (and columns (columns-to-look-at columns (rest variables))))
         (relations (and places
                         (exact-relations (mapcar (lambda (place) (nth place columns)) places) (rest variables)))))
    (maxima-list (mapcar (lambda (relation)
                           (maxima-list (loop for column below (length columns)
                                              for place = (position column places)
                                              collect (if place (nth place relation) 0))))
                         relations))))

(defun vectors-of-numbers (columns variables)
  "The vectors that COLUMNS annihilate, if their entries are rational numbers, the same modulo three primes and at three
values of all parameters; else nil."
  (let* ((echelons (echelons-of-columns 3 columns variables))
         (vectors (loop for echelon in echelons
                        collect (mapcar (lambda (vector)
                                          (loop for residue across (the residues vector)
                                                collect (rational-from-residue residue (echelon-prime echelon))))
                                        (annihilated-vectors echelon)))))
    (and vectors
         (every (lambda (others) (equal others (first vectors))) vectors)
         (notany (lambda (vector) (member nil vector)) (first vectors))
         (first vectors))))

(maxima::defmfun maxima::$anmech_seeming_relations (columns variables)
  "anmech_seeming_relations(columns, variables): the same as anmech_relations, without a proof, for who has one."
  (let ((vectors (vectors-of-numbers (mapcar #'rest (rest columns)) (rest variables))))
    (if vectors
        (maxima-list (mapcar (lambda (vector) (maxima-list (mapcar #'as-form vector))) vectors))
        (maxima::$anmech_relations columns variables))))

(defun independent-places (columns variables)
  "The numbers of those of COLUMNS, lists of forms, that are no combinations of earlier ones with constant coefficients,
as values modulo a prime show it; nil where there are no such values."
  (let ((echelon (echelon-of-columns (reverse columns) variables)) (count (length columns)))
    (and echelon
         (loop for place below count
               when (svref (echelon-pivots echelon) (- count 1 place)) collect place))))

(maxima::defmfun maxima::$anmech_spanning (functions variables)
  "anmech_spanning([f, ...], [x, ...]): those of the functions, or lists of functions, that are no combinations of
earlier ones with constant coefficients, as values modulo a prime show it."
  (let* ((functions (rest functions))
         (columns (mapcar (lambda (form) (if (operator-p form 'maxima::mlist) (rest form) (list form))) functions))
         (places (independent-places columns (rest variables))))
    (maxima-list (if places
                     (loop for place in places collect (nth place functions))
                     functions))))

(maxima::defmfun maxima::$anmech_independent_lists (columns variables)
  "anmech_independent_lists([[e_11, e_12, ..], [e_21, ..], ..], [x, ..]): the places of those of these lists that are no
combinations of earlier ones with constant coefficients, as values modulo a prime show it; [] where there are no such
values."
  (maxima-list (mapcar #'1+ (independent-places (mapcar #'rest (rest columns)) (rest variables)))))

(maxima::defmfun maxima::$anmech_pivots (columns variables)
  "anmech_pivots(columns, variables): what the elimination for anmech_relations divides by, numbers left out.  Where
one of them vanishes there may be more relations."
  (let ((rows (mapcar #'exact-row (equations-between (rest columns) (rest variables)))))
    (maxima-list (elimination-pivots (remove nil rows)))))

(defun coefficient-in (pieces column)
  "The sum of the PIECES in COLUMN."
  (sum-of (mapcar #'piece-value (remove column pieces :key #'piece-column :test-not #'eql))))

(maxima::defmfun maxima::$anmech_equations_without (columns variables)
  "anmech_equations_without([[e_11, e_12, ..], [e_21, ..], ..], [v, ..]): the equations sum_j u_j c_jk = 0, each a list
of the c_jk free of the variables, that together say  sum_j u_j e_jk = 0 for every k, identically in the variables."
  (let* ((columns (rest columns)) (count (length columns)))
    (cons '(maxima::mlist maxima::simp)
          (loop for row in (equations-between columns (rest variables))
                collect (cons '(maxima::mlist maxima::simp)
                              (loop for column below count collect (coefficient-in row column)))))))
