;;; anmech: what makes code short, and straight-line code of binary operations.
;;;
;;; The graph is rewritten three times. First, a sum of products that stands in one place only is multiplied out, so
;;; that like terms meet and cancel (derivatives of an unexpanded Lagrangian are full of terms that do). Then pairs of
;;; factors that many products have in common become units that are not taken apart again. Then every sum is factored:
;;; the factor that most of its terms share comes out first. At last the pairs of terms that occur in several sums, and
;;; of factors that occur in several products, are taken out, the most frequent first, until no pair occurs twice.
;;;
;;; Entry point: STRAIGHT-LINE. An instruction is (operation operand operand); an operand is the index of an earlier
;;; instruction, (:input . index), (:number . rational) or (:constant . name of %pi or the like): a program knows no
;;; arithmetic, and numbers are rounded by whoever runs it.
;;;
;;; Literature: M. A. Breuer, Generation of optimal code for expressions via factorization, CACM 12 (1969) 333-340;
;;; A. Hosangadi, F. Fallah, R. Kastner, Optimizing polynomial expressions by algebraic factorization and common
;;; subexpression elimination, IEEE Trans. CAD 25 (2006) 2012-2022; D. E. Knuth, The Art of Computer Programming 2,
;;; 4.6.3 (powers).

(in-package :anmech)
(needs "numerics/dag" "numerics/operations")

(defun straight-line (terms)
  "The program whose results are TERMS."
  (let ((terms (rewritten terms #'sum (multiplying-out terms))))
    (share-pairs terms '(:product) :least 3 :as :unit)
    (let ((terms (rewritten terms #'factored-sum)))
      (share-pairs terms '(:sum) :as :sum)
      (share-pairs terms '(:product :unit) :as :product)
      (program-of terms))))

(defun vertices-in (terms)
  "The vertices that TERMS are made of, operands first."
  (let ((seen (make-hash-table :test 'eq)) (vertices '()))
    (labels ((visit (vertex)
               (unless (gethash vertex seen)
                 (setf (gethash vertex seen) t)
                 (dolist (operand (vertex-operands vertex)) (visit (car operand)))
                 (push vertex vertices))))
      (dolist (term terms) (visit (car term)))
      (nreverse vertices))))

(defun rewritten (terms make-sum &optional (prepare #'identity))
  "TERMS made anew; the operands of a sum are given to PREPARE before, and to MAKE-SUM after they are rewritten."
  (let ((images (make-hash-table :test 'eq)))
    (labels ((image (vertex)
               (or (gethash vertex images)
                   (let ((image (new-image vertex)))
                     (unless (vertex-source (car image)) (setf (vertex-source (car image)) (vertex-source vertex)))
                     (setf (gethash vertex images) image))))
             (term-image (term)
               (scaled (image (car term)) (cdr term)))
             (product-image (factors)
               (product (mapcar (lambda (factor) (integer-power (image (car factor)) (cdr factor))) factors)))
             (new-image (vertex)
               (let ((operands (vertex-operands vertex)))
                 (case (vertex-kind vertex)
                   ((:one :input) (cons vertex 1))
                   (:sum (funcall make-sum (mapcar #'term-image (funcall prepare operands))))
                   (:product (product-image operands))
                   (:unit (destructuring-bind (product . coefficient) (product-image operands)
                            (cons (intern-vertex :unit (factors product)) coefficient)))
                   (t (apply-function (vertex-kind vertex) (mapcar #'term-image operands) (vertex-source vertex)))))))
      (mapcar #'term-image terms))))

;;; Multiplying out

(defun multiplying-out (terms)
  "A function that opens, in a list of terms, those with a sum of products that TERMS contain once."
  (let ((uses (make-hash-table :test 'eq)))
    (dolist (vertex (vertices-in terms))
      (dolist (operand (vertex-operands vertex))
        (incf (gethash (car operand) uses 0))))
    (labels ((opened (term)
               (multiple-value-bind (sum cofactor) (sum-and-cofactor (car term))
                 (if (and sum
                          (eql 1 (gethash sum uses))
                          (every (lambda (inner) (eq :product (vertex-kind (car inner)))) (vertex-operands sum)))
                     (mapcan (lambda (inner)
                               (opened (product (list (cons cofactor 1) (scaled inner (cdr term))))))
                             (vertex-operands sum))
                     (list term)))))
      (lambda (terms) (mapcan #'opened terms)))))

;;; Factoring

(defun factored-sum (terms)
  "The sum of TERMS, the factor that most of them share taken out first."
  (let* ((terms (collect terms))
         (best (and (rest terms) (most-common-factor terms))))
    (cond ((null terms) (constant 0))
          ((null (rest terms)) (first terms))
          ((null best) (plain-sum terms))
          (t (flet ((divisible-p (term) (/= 0 (exponent-in (car term) best))))
               (let* ((with (remove-if-not #'divisible-p terms))
                      (common (common-factors with))
                      (quotient (factored-sum (mapcar (lambda (term) (divided term common)) with))))
                 (factored-sum (cons (product (list (product-of-factors 1 common) quotient))
                                     (remove-if #'divisible-p terms)))))))))

(defun most-common-factor (terms)
  "The factor (vertex . 1 or -1) that the greatest number of TERMS contain, nil if none occurs twice."
  (let ((best nil) (most 1))
    (dolist (term terms)
      (loop for (vertex . exponent) in (factors (car term))
            for count = (if (plusp exponent) (incf (vertex-above vertex)) (incf (vertex-below vertex)))
            do (when (> count most)
                 (setq most count
                       best (cons vertex (signum exponent))))))
    (dolist (term terms best)
      (loop for (vertex) in (factors (car term))
            do (setf (vertex-above vertex) 0
                     (vertex-below vertex) 0)))))

(defun exponent-in (vertex factor)
  "The exponent that FACTOR's base has in VERTEX, 0 if it has the other sign."
  (let ((found (assoc (car factor) (factors vertex) :test #'eq)))
    (if (and found (plusp (* (cdr found) (cdr factor)))) (cdr found) 0)))

(defun common-factors (terms)
  (loop for (vertex . exponent) in (factors (car (first terms)))
        for least = (reduce (lambda (least term)
                              (let ((other (exponent-in (car term) (cons vertex exponent))))
                                (if (< (abs other) (abs least)) other least)))
                            (rest terms) :initial-value exponent)
        unless (zerop least) collect (cons vertex least)))

(defun divided (term factors)
  (product-of-factors (cdr term)
                      (append (factors (car term))
                              (mapcar (lambda (factor) (cons (car factor) (- (cdr factor)))) factors))))

;;; Pairs that occur in several sums or products

(defparameter *window* 40 "Pairs are sought among so many neighbours in a long sum or product.")

(defun share-pairs (terms kinds &key (least 2) as)
  "Replace pairs of operands that occur LEAST times in the vertices of KINDS in TERMS by new vertices of the kind AS."
  (let ((vertices (remove-if-not (lambda (vertex) (member (vertex-kind vertex) kinds)) (vertices-in terms)))
        (owners (make-hash-table :test 'equal))              ; pair -> (count . vertices)
        (waiting (make-hash-table)))                         ; count -> pairs that have reached it
    (flet ((note (owner first second)
             (let* ((relation (relation owner first second))
                    (key (list (vertex-number (car first)) (vertex-number (car second)) relation))
                    (entry (or (gethash key owners) (setf (gethash key owners) (list 0)))))
               (push owner (cdr entry))
               (when (<= least (incf (car entry)))
                 (push (list* (car first) (car second) relation entry) (gethash (car entry) waiting))))))
      (dolist (vertex vertices)
        (loop for (first . others) on (vertex-operands vertex)
              do (loop for second in others repeat *window* do (note vertex first second))))
      (loop for count downfrom (length vertices) to least
            do (loop for pair = (pop (gethash count waiting))
                     while pair
                     do (let* ((present (remove-if-not (lambda (owner) (pair-in owner pair)) (rest (cdddr pair))))
                               (number (length present)))
                          (cond ((< number least))
                                ((< number count) (push pair (gethash number waiting)))
                                (t (dolist (owner (take-out pair present as))
                                     (let* ((operands (vertex-operands owner))
                                            (new (first (last operands))))
                                       (loop for other in (butlast operands) repeat *window*
                                             do (note owner other new))))))))))))

(defun relation (owner first second)
  "What two operands of OWNER must have in common with two of another vertex, beside their vertices, to be the same
pair: the ratio of the coefficients, or the signs of the exponents."
  (if (eq :sum (vertex-kind owner))
      (/ (cdr second) (cdr first))
      (+ (* 3 (signum (cdr first))) (signum (cdr second)))))

(defun pair-in (owner pair)
  "The two operands of OWNER that are PAIR, (vertex vertex relation ...), or nil."
  (let ((first (assoc (first pair) (vertex-operands owner) :test #'eq))
        (second (assoc (second pair) (vertex-operands owner) :test #'eq)))
    (and first second (eql (third pair) (relation owner first second))
         (values first second))))

(defun take-out (pair owners as)
  "Replace PAIR in OWNERS by one vertex, which may be one of them. Those that were changed."
  (multiple-value-bind (first second) (pair-in (first owners) pair)
    (let* ((operands (if (eq as :sum)
                         (list (cons (car first) 1) (cons (car second) (third pair)))
                         (list (cons (car first) (signum (cdr first))) (cons (car second) (signum (cdr second))))))
           (vertex (or (find-if (lambda (owner)
                                (and (eq as (vertex-kind owner)) (same-operands (vertex-operands owner) operands)))
                              owners)
                     (make-vertex :kind as :operands operands :number (incf *vertex-count*))))
           (changed (remove vertex owners)))
      (dolist (owner changed changed)
        (replace-pair owner pair vertex)))))

(defun replace-pair (owner pair vertex)
  (multiple-value-bind (first second) (pair-in owner pair)
    (let* ((sum (eq :sum (vertex-kind owner)))
           (times (if sum (cdr first) (min (abs (cdr first)) (abs (cdr second))))))
      (flet ((left-over (operand)
               (let ((left (- (cdr operand) (* times (signum (cdr operand))))))
                 (if (or sum (zerop left)) '() (list (cons (car operand) left))))))
        (setf (vertex-operands owner)
              (nconc (mapcan (lambda (operand)
                               (if (or (eq operand first) (eq operand second)) (left-over operand) (list operand)))
                             (vertex-operands owner))
                     (list (cons vertex times))))))))

;;; Programs

(defstruct (program (:print-function print-program))
  (instructions (make-array 64 :adjustable t :fill-pointer 0))
  (depths (make-array 64 :adjustable t :fill-pointer 0))     ; longest chain of operations that leads to each
  (guards '())                     ; (index operation . source), for messages when an operand leaves its domain
  (table (make-hash-table :test 'equal))
  (results '()))

(defun print-program (program stream depth)
  (declare (ignore depth))
  (format stream "#<program ~d operations>" (program-length program)))

(defvar *program*)

(defun operand-depth (operand)
  (if (integerp operand) (aref (program-depths *program*) operand) 0))

(defun emit (operation operands &optional source)
  "The operand that holds OPERATION of OPERANDS. SOURCE is what a message shows when they are outside of its domain."
  (let ((key (cons operation (if (member operation '(:add :multiply)) (ordered operands) operands))))
    (or (gethash key (program-table *program*))
        (let ((index (vector-push-extend key (program-instructions *program*))))
          (vector-push-extend (1+ (reduce #'max operands :key #'operand-depth)) (program-depths *program*))
          (when (assoc operation *domains*)
            (push (list* index operation source) (program-guards *program*)))
          (setf (gethash key (program-table *program*)) index)))))

(defun ordered (operands)
  "Two OPERANDS in an order that does not depend on theirs, so that a*b and b*a are one."
  (destructuring-bind (first second) operands
    (if (and (integerp first) (or (consp second) (< second first)))
        (list second first)
        operands)))

(defun number-operand (number) (cons :number number))

(defun program-of (terms)
  (let ((*program* (make-program)))
    (count-denominators terms)
    (setf (program-results *program*) (mapcar #'term-operand terms)
          (program-table *program*) nil              ; of no use any more, and larger than all the rest
          (program-depths *program*) nil)
    *program*))

(defun program-length (program) (length (program-instructions program)))

(defun count-denominators (terms)
  "Leave in each vertex in how many products it is a denominator."
  (dolist (vertex (vertices-in terms))
    (when (member (vertex-kind vertex) '(:product :unit))
      (loop for (base . exponent) in (vertex-operands vertex)
            do (when (minusp exponent) (incf (vertex-below base)))))))

;;; Instructions of a vertex

(defun term-operand (term)
  (destructuring-bind (vertex . coefficient) term
    (cond ((constant-p term) (number-operand coefficient))
          ((eql coefficient 1) (vertex-operand vertex))
          ((eql coefficient -1) (emit :negate (list (vertex-operand vertex))))
          (t (emit :multiply (list (number-operand coefficient) (vertex-operand vertex)))))))

(defun vertex-operand (vertex)
  (or (vertex-value vertex)
      (setf (vertex-value vertex)
            (case (vertex-kind vertex)
              (:one (number-operand 1))
              (:sum (sum-operand (vertex-operands vertex)))
              ((:product :unit) (product-operand (vertex-operands vertex)))
              (t (function-operand vertex))))))

(defun function-operand (vertex)
  (emit (vertex-kind vertex) (mapcar #'term-operand (vertex-operands vertex)) (vertex-source vertex)))

(defun by-depth (items)
  (sort items #'< :key (lambda (item) (operand-depth (cdr item)))))

(defun combined (items join)
  "ITEMS, pairs of a sign and an operand, joined two by two, those first that are known first."
  (let ((items (by-depth (copy-list items))))
    (loop while (rest items)
          do (setq items (merge 'list
                                (list (funcall join (first items) (second items)))
                                (rest (rest items))
                                #'< :key (lambda (item) (operand-depth (cdr item))))))
    (first items)))

(defun join-terms (first second)
  (destructuring-bind ((sign . operand) (other-sign . other)) (list first second)
    (cond ((eql sign other-sign) (cons sign (emit :add (list operand other))))
          ((eql sign 1) (cons 1 (emit :subtract (list operand other))))
          (t (cons 1 (emit :subtract (list other operand)))))))

(defun join-factors (first second)
  (cons 1 (emit :multiply (list (cdr first) (cdr second)))))

(defun sum-operand (terms)
  "Terms of equal size of the coefficient are added before they are multiplied."
  (let ((groups '()))
    (dolist (term terms)
      (destructuring-bind (vertex . coefficient) term
        (let* ((size (if (constant-p term) 1 (abs coefficient)))
               (item (cons (if (plusp coefficient) 1 -1)
                           (if (constant-p term) (number-operand (abs coefficient)) (vertex-operand vertex))))
               (group (assoc size groups)))
          (if group (push item (cdr group)) (push (list size item) groups)))))
    (destructuring-bind (sign . operand)
        (combined (mapcan (lambda (group)
                            (if (eql 1 (car group))
                                (copy-list (cdr group))
                                (destructuring-bind (sign . operand) (combined (cdr group) #'join-terms)
                                  (list (cons sign (emit :multiply (list (number-operand (car group)) operand)))))))
                          groups)
                  #'join-terms)
      (if (eql sign 1) operand (emit :negate (list operand))))))

(defun product-operand (factors)
  "One division at most; but a denominator of several products is inverted once."
  (let ((above '()) (below '()))
    (loop for (vertex . exponent) in factors
          for operand = (vertex-operand vertex)
          do (cond ((plusp exponent) (push (power-operand operand exponent) above))
                   ((< 1 (vertex-below vertex))
                    (push (power-operand (quotient-operand (number-operand 1) operand (list vertex)) (- exponent))
                          above))
                   (t (push (power-operand operand (- exponent)) below))))
    (if (null below)
        (product-of-operands above)
        (quotient-operand (if above (product-of-operands above) (number-operand 1))
                          (product-of-operands below)
                          (mapcar #'car factors)))))

(defun quotient-operand (above below vertices)
  "ABOVE/BELOW; one of VERTICES may have the source that a message can show."
  (emit :divide (list above below)
        (some (lambda (vertex) (and (plusp (vertex-below vertex)) (vertex-source vertex))) vertices)))

(defun product-of-operands (operands)
  (cdr (combined (mapcar (lambda (operand) (cons 1 operand)) operands) #'join-factors)))

(defun power-operand (operand exponent)
  "By products of powers that differ by one at most; each is written down once, however large EXPONENT is."
  (let ((powers (list (cons 1 operand))))
    (labels ((power (k)
               (or (cdr (assoc k powers))
                   (let* ((half (floor k 2)) (product (emit :multiply (list (power half) (power (- k half))))))
                     (push (cons k product) powers)
                     product))))
      (power exponent))))
