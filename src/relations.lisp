;;; anmech: linear relations between functions, with constant coefficients.
;;;
;;; An ansatz leads to the question which constants c_j make  sum_j c_j e_j = 0  hold identically in some variables, the
;;; e_j being lists of known expressions.  The expressions are split into monomials in what depends on the variables (x,
;;; sin(x), %e^(k*t), ...), and the coefficients of each monomial give one equation between the c_j over the field of the
;;; parameters.  Elimination is exact.  First it is done modulo a prime at random values of the parameters: what is of full
;;; rank there is of full rank; otherwise it shows which rows matter, and which of the e_j are in a relation at all, often a
;;; few out of hundreds.  (Maxima's linsolve is not used: with parameters in denominators it has given wrong answers.)
;;;
;;; Functions such as x and log(x) count as independent; what is used are the addition theorems of sine and cosine, their
;;; squares, that other circular and hyperbolic functions are made of them and of exponentials, and r^n = p for the
;;; roots r = p^(1/n).  A relation that is found holds in any case; one that rests on a hidden dependence may be missed.  For
;;; parameters the answer is the generic one.
;;;
;;; Entry points: anmech_relations, anmech_equations_without, anmech_pivots.

(in-package :anmech)

(defconstant +prime+ 2147483647)

;;; Field elements: Lisp rationals, or expressions of Maxima

(defun as-rational (form)
  (if (operator-p form 'maxima::rat) (/ (second form) (third form)) form))

(defun as-form (element)
  (if (typep element 'ratio)
      (list '(maxima::rat maxima::simp) (numerator element) (denominator element))
      element))

(defun in-field (rational general &rest elements)
  "RATIONAL of the elements if they are numbers, else GENERAL of them, simplified."
  (if (every #'rationalp elements)
      (apply rational elements)
      (as-rational (maxima::$ratsimp (apply general (mapcar #'as-form elements))))))

(defun minus-product (a factor b)
  (in-field (lambda (a f b) (- a (* f b))) (lambda (a f b) (maxima::sub a (maxima::mul f b))) a factor b))

(defun quotient-of (a b)
  (in-field #'/ #'maxima::div a b))

;;; Splitting into monomials

(defstruct (piece (:type list))
  "A number times powers of parameters: part of the coefficient of the unknown of number COLUMN in a ROW of equations."
  row column factor powers)

(defun replaced-functions (form rule)
  "FORM, every operator form u in it for which (funcall RULE u) is not nil replaced by that."
  (if (atom form)
      form
      (or (funcall rule form)
          (with-arguments form (mapcar (lambda (part) (replaced-functions part rule)) (rest form))))))

(defun function-of (name argument) (maxima::simplify (list (list name) argument)))

(defun in-elementary-functions (form)
  "FORM with sines, cosines and exponentials for tangents, hyperbolic functions and the like."
  (labels ((elementary (part)
             (let ((u (and (rest part) (in-elementary-functions (second part)))))
               (flet ((ratio (above below) (maxima::div (function-of above u) (function-of below u)))
                      (over (below) (maxima::div 1 (function-of below u)))
                      (exponentials (sign) (maxima::div (maxima::add (power-of 'maxima::$%e u)
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
  "FORMS with the sines and cosines of all angles in terms of those of as few as there can be: x/6 for x/2, x/3 and x + y."
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
               (let ((maxima::$trigexpand t) (angle (sum-of (loop for (monomial . factor) in terms
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

(defun roots-of (forms)
  "A list of (base degree name) for the roots in FORMS, degree the least common one; a base before those that occur in it."
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
  (if (eql b 1) a (maxima::$ratsimp (maxima::div (maxima::mul a b) (maxima::$gcd a b)))))

(defun polynomials-of (forms)
  "FORMS times a common denominator, as canonical rational forms with numbers for denominators."
  (let* ((forms (with-common-angles (mapcar #'in-elementary-functions forms)))
         (roots (roots-of forms))
         (forms (mapcar (lambda (form) (maxima::$ratsimp (with-named-roots form roots))) forms))
         (multiple (reduce #'common-multiple (mapcar #'maxima::$denom forms) :initial-value 1)))
    (flet ((cleared (form)
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
      (loop for polynomial in (polynomials-of (mapcar (lambda (column) (nth component (rest column))) columns))
            for column from 0
            do (dolist (piece (pieces-of polynomial component column variables))
                 (push piece (gethash (piece-row piece) rows)))))
    (sort (loop for row being the hash-values of rows collect row) #'< :key #'length)))

;;; Rows modulo a prime, at random values of the parameters

(defun inverse-modulo-prime (a)
  (let ((result 1) (exponent (- +prime+ 2)))
    (loop while (plusp exponent)
          do (when (oddp exponent) (setq result (mod (* result a) +prime+)))
             (setq a (mod (* a a) +prime+) exponent (ash exponent -1)))
    result))

(defun residue-of-power (kernel exponent)
  (let ((value (1+ (floor (* (- +prime+ 2) (scrambled (format nil "~s" (form-without-flags kernel)))))))
        (result 1))
    (dotimes (k exponent result) (setq result (mod (* result value) +prime+)))))

(defun residue-of-number (number)
  (if (integerp number)
      (mod number +prime+)
      (mod (* (numerator number) (inverse-modulo-prime (mod (denominator number) +prime+))) +prime+)))

(defun residue-row (pieces)
  "An alist column -> residue, sorted, without zeros."
  (let ((row '()))
    (dolist (piece pieces)
      (let ((place (or (assoc (piece-column piece) row) (first (push (cons (piece-column piece) 0) row))))
            (value (residue-of-number (piece-factor piece))))
        (loop for (kernel . exponent) in (piece-powers piece)
              do (setq value (mod (* value (residue-of-power kernel exponent)) +prime+)))
        (setf (cdr place) (mod (+ (cdr place) value) +prime+))))
    (sort (remove 0 row :key #'cdr) #'< :key #'car)))

(defun subtract-row (row factor other minus)
  "ROW - FACTOR * OTHER, both sorted alists; MINUS combines (a factor b)."
  (let ((result '()))
    (loop while (or row other)
          do (cond ((or (null other) (and row (< (caar row) (caar other)))) (push (pop row) result))
                   (t (let ((value (if (and row (= (caar row) (caar other)))
                                       (funcall minus (cdr (pop row)) factor (cdar other))
                                       (funcall minus 0 factor (cdar other)))))
                        (unless (eql value 0) (push (cons (caar other) value) result))
                        (pop other)))))
    (nreverse result)))

(defun minus-product-modulo-prime (a factor b) (mod (- a (* factor b)) +prime+))

(defun unit-row (residues)
  (let ((scale (inverse-modulo-prime (cdr (first residues)))))
    (mapcar (lambda (pair) (cons (car pair) (mod (* scale (cdr pair)) +prime+))) residues)))

(defun independent-rows (rows)
  "Those of ROWS, lists of pieces, that are independent modulo the prime, and what becomes of them: rows with the leading
entry 1, without the leading columns of the rows before."
  (let ((pivots '()) (independent '()))
    (dolist (row rows)
      (let ((residues (residue-row row)))
        (dolist (pivot (reverse pivots))
          (let ((place (assoc (caar pivot) residues)))
            (when place
              (setq residues (subtract-row residues (cdr place) pivot #'minus-product-modulo-prime)))))
        (when residues
          (push row independent)
          (push (unit-row residues) pivots))))
    (values (nreverse independent) (nreverse pivots))))

(defun columns-in-relations (pivots count)
  "The numbers of the columns, of COUNT, that are in some relation modulo the prime."
  (let ((leading (mapcar #'caar pivots)) (found (make-array count :initial-element nil)))
    (dotimes (free count)
      (unless (member free leading)
        (let ((vector (make-array count :initial-element 0)))
          (setf (aref vector free) 1)
          (dolist (pivot (reverse pivots))
            (setf (aref vector (caar pivot))
                  (mod (- (loop for (column . residue) in (rest pivot) sum (* residue (aref vector column)))) +prime+)))
          (dotimes (column count)
            (unless (eql 0 (aref vector column)) (setf (aref found column) t))))))
    (loop for column below count when (aref found column) collect column)))

;;; Exact elimination

(defun exact-row (pieces)
  (let ((row '()))
    (dolist (piece pieces)
      (push (apply #'product-of (as-form (piece-factor piece))
                   (loop for (kernel . exponent) in (piece-powers piece) collect (power-of kernel exponent)))
            (getf row (piece-column piece))))
    (sort (loop for (column terms) on row by #'cddr
                for value = (as-rational (maxima::$ratsimp (sum-of terms)))
                unless (eql value 0) collect (cons column value))
          #'< :key #'car)))

(defun pivot-cost (row)
  "Short rows first, and among them those with a number to divide by."
  (+ (* 4 (length row)) (if (some (lambda (pair) (rationalp (cdr pair))) row) 0 2)))

(defun pivot-of (row)
  (or (find-if (lambda (pair) (rationalp (cdr pair))) row) (first row)))

(defun reduced-rows (rows)
  "A list of (column . row): the unknown of that column is minus the rest of the row, in which no other such column occurs."
  (let ((done '()))
    (loop while rows
          do (let* ((row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b)) rows))
                    (pivot (pivot-of row))
                    (unit (mapcar (lambda (pair) (cons (car pair) (quotient-of (cdr pair) (cdr pivot)))) row)))
               (flet ((clear (other)
                        (let ((place (assoc (car pivot) other)))
                          (if place (subtract-row other (cdr place) unit #'minus-product) other))))
                 (setq rows (remove nil (mapcar #'clear (remove row rows :test #'eq :count 1)))
                       done (acons (car pivot) unit
                                   (mapcar (lambda (pair) (cons (car pair) (clear (cdr pair)))) done))))))
    done))

(defun without-denominators (vector)
  "A multiple of VECTOR without denominators."
  (let ((multiple 1))
    (dolist (form vector)
      (let ((denominator (maxima::$denom form)))
        (setq multiple (maxima::$ratsimp (maxima::div (maxima::mul multiple denominator)
                                                      (maxima::$gcd multiple denominator))))))
    (mapcar (lambda (form) (maxima::$ratsimp (maxima::mul multiple form))) vector)))

(defun null-vectors (rows count)
  "A basis of the vectors of COUNT entries that ROWS annihilate."
  (let ((solved (reduced-rows rows)))
    (loop for free below count
          unless (assoc free solved)
            collect (without-denominators
                     (loop for j below count
                           for row = (cdr (assoc j solved))
                           collect (cond ((= j free) 1)
                                         ((assoc free row) (as-form (in-field #'- #'maxima::neg (cdr (assoc free row)))))
                                         (t 0)))))))

(defun rows-in-columns (rows columns)
  "ROWS of pieces, only those in COLUMNS, whose places become their numbers."
  (remove nil (mapcar (lambda (row)
                        (loop for piece in row
                              for place = (position (piece-column piece) columns)
                              when place collect (make-piece :row (piece-row piece) :column place
                                                             :factor (piece-factor piece) :powers (piece-powers piece))))
                      rows)))

(defun annihilated-vectors (rows count)
  "A basis of the vectors of COUNT entries that ROWS, lists of pieces, annihilate."
  (multiple-value-bind (independent pivots) (independent-rows rows)
    (let* ((nullity (- count (length independent)))
           (columns (columns-in-relations pivots count))
           (vectors (and (plusp nullity)
                         (null-vectors (mapcar #'exact-row (independent-rows (rows-in-columns independent columns)))
                                       (length columns)))))
      (if (= (length vectors) nullity)
          (mapcar (lambda (vector)
                    (loop for column below count
                          for place = (position column columns)
                          collect (if place (nth place vector) 0)))
                  vectors)
          (null-vectors (mapcar #'exact-row independent) count)))))      ; the random values met a special case

(maxima::defmfun maxima::$anmech_relations (columns variables)
  "anmech_relations([[e_11, e_12, ..], [e_21, ..], ..], [x, ..]): a basis of the lists c, free of the variables, with
sum_j c_j e_jk = 0 for every k, identically in the variables."
  (let ((columns (rest columns)))
    (cons '(maxima::mlist maxima::simp)
          (mapcar (lambda (vector) (cons '(maxima::mlist maxima::simp) vector))
                  (annihilated-vectors (equations-between columns (rest variables)) (length columns))))))

(defun elimination-pivots (rows)
  "The pivots, without numbers, of an elimination of exact ROWS that divides by parameters as late as it can."
  (let ((pivots '()))
    (loop while rows
          do (let* ((row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b)) rows))
                    (pivot (pivot-of row)))
               (unless (rationalp (cdr pivot)) (push (cdr pivot) pivots))
               (setq rows (loop for other in (remove row rows :test #'eq :count 1)
                                for place = (assoc (car pivot) other)
                                for rest = (if place
                                               (subtract-row other (quotient-of (cdr place) (cdr pivot)) row #'minus-product)
                                               other)
                                when rest collect rest))))
    (nreverse pivots)))

(maxima::defmfun maxima::$anmech_pivots (columns variables)
  "anmech_pivots(columns, variables): what the elimination for anmech_relations divides by, numbers left out.  Where one of
them vanishes there may be more relations."
  (cons '(maxima::mlist maxima::simp)
        (elimination-pivots (remove nil (mapcar #'exact-row (equations-between (rest columns) (rest variables)))))))

(defun coefficient-in (pieces column)
  "The sum of the PIECES in COLUMN."
  (sum-of (loop for piece in pieces
                when (eql (piece-column piece) column)
                  collect (apply #'product-of (as-form (piece-factor piece))
                                 (loop for (kernel . exponent) in (piece-powers piece)
                                       collect (power-of kernel exponent))))))

(maxima::defmfun maxima::$anmech_equations_without (columns variables)
  "anmech_equations_without([[e_11, e_12, ..], [e_21, ..], ..], [v, ..]): the equations sum_j u_j c_jk = 0, each a list of the c_jk free
of the variables, that together say  sum_j u_j e_jk = 0 for every k, identically in the variables."
  (let* ((columns (rest columns)) (count (length columns)))
    (cons '(maxima::mlist maxima::simp)
          (loop for row in (equations-between columns (rest variables))
                collect (cons '(maxima::mlist maxima::simp)
                              (loop for column below count collect (coefficient-in row column)))))))
