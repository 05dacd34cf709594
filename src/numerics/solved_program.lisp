;;; anmech: equations A u = b as straight-line programs that solve them.
;;;
;;; The elimination is written down as instructions: so whoever runs a program with numbers of his own, or takes its
;;; derivatives, needs no linear algebra.  The pivots are chosen once, by the values of the entries at one point; rows
;;; where an entry is zero everywhere are not touched.
;;;
;;; Entry point: SOLVED-PROGRAM.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/evaluation" "numerics/long_numbers" "numerics/model" "numerics/series_program"
       "numerics/sharing")

(defparameter *pivot-bits* 80 "Of the numbers that pivots are chosen by.")

(defun solved-program (model inputs)
  "The program of the rates of MODEL, followed by all unknowns; INPUTS are rational numbers near which pivots are good.
Where the equations were solved before, of the unknowns there are those that are rates.  And the places of the rows that
were chosen, a list."
  (let ((program (model-exact-program model)) (arrangement (model-arrangement model)) (n (model-dimension model)))
    (if (null arrangement)
        (let ((rates (copy-program program)))
          (setf (program-results rates)
                (append (program-results program) (nthcdr (model-solved model) (program-results program))))
          (values rates '()))
        (let* ((values (funcall (the function (program-function program (long-numbers *pivot-bits*))) inputs))
               (entries (mapcar #'cons (program-results program) values))
               (solver (make-solver :instructions (reverse (coerce (program-instructions program) 'list))
                                    :size (length (program-instructions program))))
               (linear (linear-series-of arrangement entries))
               (found (multiple-value-list (written-solution solver linear)))
               (solution (first found))
               (unknowns (loop for found in (unknown-rates arrangement entries (length (model-unknowns model)))
                               collect (car (if (eq :unknown (car found)) (svref solution (cdr found)) found)))))
          (values (make-program :instructions (coerce (reverse (solver-instructions solver)) 'simple-vector)
                                :guards (program-guards program)
                                :results (append (mapcar (lambda (place) (cons :input place)) (model-places model))
                                                 (subseq unknowns 0 (- n (model-solved model)))
                                                 unknowns))
                  (second found))))))

;;; An entry is a pair (operand . value) where it is not zero everywhere, else nil

(defstruct solver instructions size)

(defun written (solver operation a b value)
  "The entry that OPERATION gives of the entries A and B."
  (push (list operation (car a) (car b)) (solver-instructions solver))
  (prog1 (cons (solver-size solver) (rounded value *pivot-bits*))
    (incf (solver-size solver))))

(defun written-solution (solver linear)
  "The vector of the entries of the solution, and the places of the rows of the pivots."
  (let* ((size (linear-series-size linear)) (chosen '())
         (rows (coerce (loop for right in (linear-series-rights linear)
                             collect (let ((row (make-array (1+ size) :initial-element nil)))
                                       (setf (svref row size) (entry-or-nil right))
                                       row))
                       'vector)))
    (loop for (i j entry) in (linear-series-entries linear)
          do (setf (svref (aref rows i) j) (entry-or-nil entry)))
    (dotimes (k size)
      (let ((best (best-pivot rows k size)))
        (unless best (error 'domain-violation :operation :solve :source nil))
        (push best chosen)
        (rotatef (aref rows k) (aref rows best))
        (loop for i from (1+ k) below size do (eliminate-entry solver (aref rows i) (aref rows k) k))))
    (values (solved-backwards solver rows size) (nreverse chosen))))

(defun entry-or-nil (entry) (unless (equal (car entry) '(:number . 0)) entry))

(defun best-pivot (rows k size)
  "Below K, the row whose entry is largest in proportion to the others of it; nil if all are zero."
  (let ((best nil) (largest 0))
    (loop for i from k below size
          for row = (aref rows i)
          for entry = (svref row k)
          for others = (loop for j from k below size when (svref row j) maximize (abs (cdr (svref row j))))
          do (when (and entry (> (abs (cdr entry)) (* largest others)))
               (setq best i largest (/ (abs (cdr entry)) others))))
    best))

(defun eliminate-entry (solver row pivots k)
  (when (svref row k)
    (let* ((a (svref row k)) (b (svref pivots k)) (factor (written solver :divide a b (/ (cdr a) (cdr b)))))
      (loop for j from (1+ k) below (length row)
            for pivot = (svref pivots j)
            do (when pivot
                 (let ((product (written solver :multiply factor pivot (* (cdr factor) (cdr pivot))))
                       (entry (svref row j)))
                   (setf (svref row j)
                         (if entry
                             (written solver :subtract entry product (- (cdr entry) (cdr product)))
                             (cons (written-negative solver product) (- (cdr product)))))))))))

(defun written-negative (solver entry)
  (push (list :negate (car entry)) (solver-instructions solver))
  (prog1 (solver-size solver) (incf (solver-size solver))))

(defun solved-backwards (solver rows size)
  (let ((solution (make-array size :initial-element nil)))
    (loop for k from (1- size) downto 0
          for row = (aref rows k)
          do (let ((right (svref row size)))
               (loop for j from (1+ k) below size
                     do (when (and (svref row j) (svref solution j))
                          (let* ((a (svref row j)) (b (svref solution j))
                                 (product (written solver :multiply a b (* (cdr a) (cdr b)))))
                            (setq right
                                  (if right
                                      (written solver :subtract right product (- (cdr right) (cdr product)))
                                      (cons (written-negative solver product) (- (cdr product))))))))
               (setf (svref solution k)
                     (and right (written solver :divide right (svref row k) (/ (cdr right) (cdr (svref row k))))))))
    (map 'vector (lambda (entry) (or entry '((:number . 0) . 0))) solution)))
