;;; From a graph of n-ary sums and products to straight-line code of binary operations.
;;;
;;; First the pairs of terms that occur in several sums, and the pairs of factors that occur in several products, are
;;; taken out, the most frequent first, until no pair occurs twice; then every node becomes instructions, each once.
;;;
;;; Entry point: STRAIGHT-LINE. An instruction is (operation operand operand); an operand is the index of an earlier
;;; instruction, (:input . index) or (:number . double).
;;;
;;; Literature: A. Hosangadi, F. Fallah, R. Kastner, Optimizing polynomial expressions by algebraic factorization and
;;; common subexpression elimination, IEEE Trans. CAD 25 (2006) 2012-2022 (greedy choice of pairs); D. E. Knuth, The Art
;;; of Computer Programming 2, 4.6.3 (powers).

(in-package :anmech)

(defstruct (program (:print-function print-program))
  (instructions (make-array 64 :adjustable t :fill-pointer 0))
  (depths (make-array 64 :adjustable t :fill-pointer 0))     ; longest chain of operations that leads to each
  (guards '())                     ; (index operation . source), for messages when an operand leaves its domain
  (table (make-hash-table :test 'equal))
  (results '()))

(defun print-program (program stream depth)
  (declare (ignore depth))
  (format stream "#<program ~d operations>" (length (program-instructions program))))

(defvar *program*)

(defun operand-depth (operand)
  (if (integerp operand) (aref (program-depths *program*) operand) 0))

(defun emit (operation &rest operands)
  "The operand that holds OPERATION of OPERANDS."
  (let ((key (cons operation operands)))
    (or (gethash key (program-table *program*))
        (progn
          (vector-push-extend (1+ (reduce #'max operands :key #'operand-depth)) (program-depths *program*))
          (setf (gethash key (program-table *program*))
                (vector-push-extend key (program-instructions *program*)))))))

(defun emit-guarded (source operation &rest operands)
  "EMIT; SOURCE is what a message shows when the operands are outside of the domain of OPERATION."
  (let ((index (apply #'emit operation operands)))
    (unless (assoc index (program-guards *program*))
      (push (list* index operation source) (program-guards *program*)))
    index))

(defun number-operand (number) (cons :number (to-double number)))

(defun straight-line (terms)
  "The program whose results are TERMS."
  (let ((*program* (make-program)))
    (share-pairs terms)
    (setf (program-results *program*) (mapcar #'term-operand terms))
    *program*))

(defun share-pairs (terms) terms)

;;; Instructions of a node

(defun term-operand (term)
  (destructuring-bind (node . coefficient) term
    (cond ((constant-p term) (number-operand coefficient))
          ((eql coefficient 1) (node-operand node))
          ((eql coefficient -1) (emit :negate (node-operand node)))
          (t (emit :multiply (number-operand coefficient) (node-operand node))))))

(defun node-operand (node)
  (or (node-value node)
      (setf (node-value node)
            (case (node-kind node)
              (:one (number-operand 1))
              (:sum (sum-operand (node-operands node)))
              (:product (product-operand (node-operands node)))
              (t (function-operand node))))))

(defun function-operand (node)
  (apply #'emit-guarded (node-source node) (node-kind node) (mapcar #'term-operand (node-operands node))))

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
    (cond ((eql sign other-sign) (cons sign (emit :add operand other)))
          ((eql sign 1) (cons 1 (emit :subtract operand other)))
          (t (cons 1 (emit :subtract other operand))))))

(defun join-factors (first second)
  (cons 1 (emit :multiply (cdr first) (cdr second))))

(defun sum-operand (terms)
  "Terms of equal size of the coefficient are added before they are multiplied."
  (let ((groups '()))
    (dolist (term terms)
      (destructuring-bind (node . coefficient) term
        (let* ((size (if (constant-p term) 1 (abs coefficient)))
               (item (cons (if (plusp coefficient) 1 -1)
                           (if (constant-p term) (number-operand (abs coefficient)) (node-operand node))))
               (group (assoc size groups)))
          (if group (push item (cdr group)) (push (list size item) groups)))))
    (destructuring-bind (sign . operand)
        (combined (mapcan (lambda (group)
                            (if (eql 1 (car group))
                                (copy-list (cdr group))
                                (destructuring-bind (sign . operand) (combined (cdr group) #'join-terms)
                                  (list (cons sign (emit :multiply (number-operand (car group)) operand))))))
                          groups)
                  #'join-terms)
      (if (eql sign 1) operand (emit :negate operand)))))

(defun product-operand (factors)
  (flet ((operand-of (factors)
           (cdr (combined (mapcar (lambda (factor)
                                    (cons 1 (power-operand (node-operand (car factor)) (abs (cdr factor)))))
                                  factors)
                          #'join-factors))))
    (let ((above (remove-if-not #'plusp factors :key #'cdr))
          (below (remove-if #'plusp factors :key #'cdr)))
      (if (null below)
          (operand-of above)
          (emit-guarded (some (lambda (factor) (node-source (car factor))) below)
                        :divide
                        (if above (operand-of above) (number-operand 1))
                        (operand-of below))))))

(defun power-operand (operand exponent)
  (if (eql exponent 1)
      operand
      (let ((half (floor exponent 2)))
        (emit :multiply (power-operand operand half) (power-operand operand (- exponent half))))))
