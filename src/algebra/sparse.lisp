;;; anmech: sparse linear equations, modulo a prime, and exactly over a field of rational functions of parameters.
;;;
;;; Modulo a prime (residues.lisp) a row is an alist from columns to residues; rows are collected in an echelon, which
;;; takes the last column of each for its pivot.  This is fast, and tells which rows and columns matter.
;;;
;;; An exact row is an alist from columns to field elements, sorted by columns, without zeros.  Elements are Lisp
;;; rationals wherever they can be, else expressions of Maxima.  Pivots are taken from short rows, and numbers before
;;; expressions, so that parameters are divided by as late as possible; what has to be divided by tells for which of
;;; their values the result does not hold.  (Maxima's linsolve is not used: with parameters in denominators it has
;;; given wrong answers.)
;;;
;;; Entry points: NEW-ECHELON, INSERT-ROW, INSERT-ROWS, INSERT-EQUATION, NULL-VECTOR-OF, REMAINDER,
;;; ANNIHILATED-VECTORS, OCCURRING-COLUMNS; NULL-VECTORS, ELIMINATION-PIVOTS, anmech_reduced_echelon; AS-FORM,
;;; AS-RATIONAL.
;;;
;;; Literature: I. S. Duff, A. M. Erisman, J. K. Reid, Direct Methods for Sparse Matrices (1986), chapter 7.

(in-package :anmech)
(needs "session/patience" "session/scope" "arithmetic/floats" "arithmetic/residues" "arithmetic/series")

;;; Rows modulo the prime

(defstruct echelon
  "PIVOTS: for each column nil or (columns . entries), the rest of a row whose leading entry there is 1.  LEVELS: a
number given with that row.  WORK: zeros.  PRIME: that of the entries."
  (prime *prime* :type fixnum) (pivots nil :type simple-vector) (levels nil :type residues) (work nil :type residues))

(declaim (ftype (function (fixnum t t) fixnum) eliminate-row)
         (ftype (function (t t fixnum t fixnum) t) subtract-multiple))

(defun new-echelon (width &optional before)
  (let ((echelon (make-echelon :pivots (make-array width :initial-element nil)
                               :levels (make-array width :element-type 'fixnum :initial-element 0)
                               :work (make-array width :element-type 'fixnum :initial-element 0))))
    (when before
      (replace (echelon-pivots echelon) (echelon-pivots before))
      (replace (echelon-levels echelon) (echelon-levels before)))
    echelon))

(defun subtract-multiple (columns entries factor work square)
  "Subtract FACTOR times packed entries from WORK, modulo SQUARE, that of the prime: a remainder modulo the prime for
each product would take most of the time."
  (declare (type residues columns entries work) (fixnum factor square))
  (with-fast-arithmetic
    (for (k (length columns))
      (let* ((place (aref columns k)) (before (aref work place)) (entry (aref entries k))
             (value (fix (- before (* factor entry)))))
        (declare (fixnum place before entry value))
        (when (< value 0) (setq value (fix (+ value square))))
        (setf (aref work place) value)))
    nil))

(defun eliminate-row (top work pivots)
  "Reduce the row in WORK, whose last entry is at TOP; the column of what is then its last entry, or -1.  The entries
may be any below the square of the prime; those left are residues."
  (declare (fixnum top) (type residues work) (type simple-vector pivots))
  (with-fast-arithmetic
    (let* ((lead -1) (prime *prime*) (square (fix (* prime prime))))
      (declare (fixnum lead prime square))
      (do ((column top (fix (- column 1))))
          ((< column 0) lead)
        (declare (fixnum column))
        (let ((value (rem (aref work column) prime)))
          (declare (fixnum value))
          (setf (aref work column) value)
          (unless (= 0 value)
            (let ((row (svref pivots column)))
              (cond (row
                     (setf (aref work column) 0)
                     (subtract-multiple (car row) (cdr row) value work square))
                    ((< lead 0) (setq lead column))))))))))

(defun scatter (entries work)
  "Add ENTRIES, pairs of a column and a residue, to WORK; the last column."
  (declare (type residues work))
  (with-fast-arithmetic
    (let ((top -1) (prime *prime*))
      (declare (fixnum top prime))
      (dolist (pair entries top)
        (let ((column (car pair)) (value (cdr pair)))
          (declare (fixnum column value))
          (setf (aref work column) (plus-product (aref work column) 1 value prime))
          (when (> column top) (setq top column)))))))

(defun packed (entries)
  "ENTRIES as two arrays, of the columns and of the residues."
  (cons (fixnums (mapcar #'car entries)) (fixnums (mapcar #'cdr entries))))

(defun gather (work top)
  "Take the entries out of WORK: an alist, the last column first."
  (declare (type residues work) (fixnum top))
  (let ((entries '()))
    (for (column (1+ top))
      (unless (= 0 (aref work column))
        (push (cons column (aref work column)) entries)
        (setf (aref work column) 0)))
    entries))

(defun absorb-row (top echelon level)
  "Whether the row in the work of ECHELON, whose last entry is at TOP, is a new one; if so it is in ECHELON now, and
the leading entry and its column are the values."
  (poll)
  (let* ((work (echelon-work echelon)) (lead (eliminate-row top work (echelon-pivots echelon))))
    (unless (< lead 0)
      (let* ((row (gather work lead)) (scale (inverse-residue (cdr (first row)))))
        (setf (svref (echelon-pivots echelon) lead)
              (cons (fixnums (mapcar #'car (rest row)))
                    (fixnums (mapcar (lambda (pair) (mod (* scale (cdr pair)) *prime*)) (rest row))))
              (aref (echelon-levels echelon) lead) level)
        (values (cdr (first row)) lead)))))

(defun insert-row (entries echelon level)
  (absorb-row (scatter entries (echelon-work echelon)) echelon level))

(defun scatter-combination (rows first step echelon)
  "Put a random combination of every STEP-th of ROWS, from FIRST on, into the work of ECHELON; the last column.  A row
is (last column columns . entries)."
  (let ((square (* *prime* *prime*)) (top -1))
    (loop for k from first below (length rows) by step
          for (last columns . entries) = (svref rows k)
          do (subtract-multiple columns entries (random-residue) (echelon-work echelon) square)
             (setq top (max top last)))
    top))

(defun insert-combinations (rows echelon level)
  "Random combinations of ROWS until two in succession of all of them are nothing new; of few of them as long as these
are, for that is faster."
  (let ((step (max 1 (floor (length rows) 32))) (idle 0))
    (loop for turn from 0
          until (= idle 2)
          do (cond ((absorb-row (scatter-combination rows (mod turn step) step echelon) echelon level) (setq idle 0))
                   ((> step 1) (setq step (floor step 2)))
                   (t (incf idle))))))

(defun insert-rows (rows echelon level)
  "One row for each leading jet, then combinations of all the others."
  (let ((others '()))
    (dolist (row rows)
      (when row
        (let ((last (reduce #'max row :key #'car)))
          (if (svref (echelon-pivots echelon) last)
              (push (cons last (packed row)) others)
              (insert-row row echelon level)))))
    (when others (insert-combinations (coerce others 'simple-vector) echelon level))))

(defun remainder (entries echelon)
  "ENTRIES without the leading jets, as an alist."
  (let* ((work (echelon-work echelon)) (top (scatter entries work)))
    (eliminate-row top work (echelon-pivots echelon))
    (gather work top)))

(defun annihilated-vectors (echelon)
  "The vectors annihilated by the rows of ECHELON: for each column without a pivot one, which has 1 there and 0 in the
others."
  (let* ((pivots (echelon-pivots echelon)) (count (length pivots)) (*prime* (echelon-prime echelon)))
    (loop for free below count
          unless (svref pivots free)
            collect (let ((vector (make-array count :element-type 'fixnum :initial-element 0)))
                      (setf (aref vector free) 1)
                      (loop for k from (1+ free) below count
                            for row = (svref pivots k)
                            when row
                              do (setf (aref vector k) (opposite-product (car row) (cdr row) vector)))
                      vector))))

(defun opposite-product (columns entries vector)
  "Minus the sum of the products of ENTRIES and what VECTOR has in COLUMNS."
  (declare (type residues columns entries vector))
  (with-fast-arithmetic
    (let ((sum 0) (prime *prime*))
      (declare (fixnum sum prime))
      (for (k (length columns))
        (setq sum (plus-product sum (aref entries k) (aref vector (aref columns k)) prime)))
      (if (= sum 0) 0 (fix (- prime sum))))))

(defun occurring-columns (echelon)
  "The numbers of the columns that occur in some vector annihilated by the rows of ECHELON."
  (let ((vectors (annihilated-vectors echelon)))
    (loop for k below (length (echelon-pivots echelon))
          when (some (lambda (vector) (/= 0 (aref (the residues vector) k))) vectors) collect k)))

(defun insert-equation (row echelon)
  "The same for ROW, a list of all its entries, which are numbered from the last one to the first."
  (insert-row (loop for entry in row
                    for column downfrom (1- (length row))
                    unless (= 0 entry) collect (cons column entry))
              echelon 0))

(defun null-vector-of (echelon)
  "The first vector, as a list, that the equations in ECHELON annihilate, its last entry that is not zero being 1; or
nil."
  (let* ((pivots (echelon-pivots echelon)) (width (length pivots))
         (free (loop for k downfrom (1- width) to 0 unless (svref pivots k) return k)))
    (when free
      (let ((vector (make-array width :initial-element 0)))
        (setf (aref vector free) 1)
        (loop for k from (1+ free) below width
              for (columns . entries) = (svref pivots k)
              do (setf (aref vector k)
                       (mod (- (loop for column across (the residues columns)
                                     for entry across (the residues entries)
                                     sum (* entry (aref vector column))))
                            *prime*)))
        (nreverse (coerce vector 'list))))))

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

;;; Rows

(defun subtract-row (row factor other)
  "ROW - FACTOR * OTHER."
  (let ((result '()))
    (loop while (or row other)
          do (cond ((or (null other) (and row (< (caar row) (caar other)))) (push (pop row) result))
                   (t (let ((value (if (and row (= (caar row) (caar other)))
                                       (minus-product (cdr (pop row)) factor (cdar other))
                                       (minus-product 0 factor (cdar other)))))
                        (unless (eql value 0) (push (cons (caar other) value) result))
                        (pop other)))))
    (nreverse result)))

(defun pivot-cost (row)
  "Short rows first, and among them those with a number to divide by."
  (+ (* 4 (length row)) (if (some (lambda (pair) (rationalp (cdr pair))) row) 0 2)))

(defun pivot-of (row)
  (or (find-if (lambda (pair) (rationalp (cdr pair))) row) (first row)))

(defun reduced-rows (rows)
  "A list of (column . row): the unknown of that column is minus the rest of the row, in which no other such column
occurs."
  (let ((done '()))
    (loop while rows
          do (poll)
             (let* ((row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b)) rows))
                    (pivot (pivot-of row))
                    (unit (mapcar (lambda (pair) (cons (car pair) (quotient-of (cdr pair) (cdr pivot)))) row)))
               (flet ((clear (other)
                        (let ((place (assoc (car pivot) other)))
                          (if place (subtract-row other (cdr place) unit) other))))
                 (setq rows (remove nil (mapcar #'clear (remove row rows :test #'eq :count 1)))
                       done (acons (car pivot) unit
                                   (mapcar (lambda (pair) (cons (car pair) (clear (cdr pair)))) done))))))
    done))

(defun without-denominators (vector)
  "A multiple of VECTOR without denominators."
  (poll)
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
                                         ((assoc free row)
                                          (as-form (in-field #'- #'maxima::neg (cdr (assoc free row)))))
                                         (t 0)))))))

(defun unit-row (row)
  (let ((lead (cdr (first row))))
    (mapcar (lambda (pair) (cons (car pair) (quotient-of (cdr pair) lead))) row)))

(defun reduced-echelon (rows)
  "Rows of the reduced echelon form of exact, independent ROWS: each begins with 1 where all others have nothing."
  (let ((done '()))
    (loop while rows
          do (poll)
             (let* ((place (reduce #'min rows :key #'caar))
                    (row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b))
                                 (remove place rows :key #'caar :test-not #'eql)))
                    (unit (unit-row row)))
               (flet ((clear (other)
                        (let ((entry (assoc place other)))
                          (if entry (subtract-row other (cdr entry) unit) other))))
                 (setq rows (remove nil (mapcar #'clear (remove row rows :test #'eq :count 1)))
                       done (cons unit (mapcar #'clear done))))))
    (reverse done)))

(maxima::defmfun maxima::$anmech_reduced_echelon (rows)
  "anmech_reduced_echelon([[c_11, ...], ...]): the reduced echelon form of independent rows."
  (let ((count (if (rest rows) (length (rest (second rows))) 0)))
    (flet ((sparse (row)
             (loop for form in (rest row)
                   for column from 0
                   for value = (as-rational (maxima::$ratsimp form))
                   unless (eql value 0) collect (cons column value)))
           (full (row)
             (cons '(maxima::mlist maxima::simp)
                   (loop for column below count
                         for entry = (assoc column row)
                         collect (if entry (as-form (cdr entry)) 0)))))
      (cons '(maxima::mlist maxima::simp) (mapcar #'full (reduced-echelon (mapcar #'sparse (rest rows))))))))

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
                                               (subtract-row other (quotient-of (cdr place) (cdr pivot)) row)
                                               other)
                                when rest collect rest))))
    (nreverse pivots)))
