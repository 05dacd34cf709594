;;; anmech: derivatives of straight-line programs, and the matrix of those of a field by its states.
;;;
;;; A program is differentiated forwards, instruction by instruction; derivatives that are zero are never written, those
;;; that are 1 never multiplied by.  What comes of it is a program again, with the derivatives as results.  It runs in
;;; registers (registers.lisp): a matrix of derivatives is wanted once in many values of the field, not worth compiling.
;;;
;;; Of equations A u = b the unknowns have the derivatives  A u' = b' - A' u,  with the factors of A.
;;;
;;; Entry points: DIFFERENTIATED-PROGRAM, FIELD-DERIVATIVES.
;;;
;;; Literature: A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed. 2008, 3.1.

(in-package :anmech)
(needs "arithmetic/elimination" "arithmetic/floats" "numerics/arrangement" "numerics/model" "numerics/registers"
       "numerics/sharing")

;;; Programs

(defun differentiated-program (program count)
  "A program whose results are the derivatives of those of PROGRAM by the first COUNT inputs, but for the zeros; and for
each of them the pair of the result's place and the input's."
  (let* ((instructions (program-instructions program)) (size (length instructions))
         (code (reverse (coerce instructions 'list))) (known (make-hash-table :test 'equal))
         (changes (make-array size :initial-element '())) (results '()) (places '()))
    (labels ((emit-once (operation a &optional b)
               (let ((instruction (if b (list operation a b) (list operation a))))
                 (or (gethash instruction known)
                     (prog1 (setf (gethash instruction known) size)
                       (push instruction code)
                       (incf size)))))
             (changes-of (operand)
               "An alist of inputs and derivatives."
               (cond ((integerp operand) (svref changes operand))
                     ((and (consp operand) (eq :input (car operand)) (< (cdr operand) count))
                      (list (cons (cdr operand) '(:number . 1))))))
             (times (factor change)
               (cond ((equal factor '(:number . 1)) change)
                     ((equal change '(:number . 1)) factor)
                     (t (emit-once :multiply factor change))))
             (scaled-changes (factor changes)
               (loop for (input . change) in changes collect (cons input (times factor change))))
             (joined (first second)
               (let ((sums (copy-alist first)))
                 (loop for (input . change) in second
                       for entry = (assoc input sums)
                       do (if entry
                              (setf (cdr entry) (emit-once :add (cdr entry) change))
                              (push (cons input change) sums)))
                 sums)))
      (loop for instruction across instructions for index from 0 do (setf (gethash instruction known) index))
      (loop for (operation a b) across instructions
            for index from 0
            for da = (changes-of a)
            for db = (changes-of b)
            do (when (or da db)
                 (destructuring-bind (by-a by-b)
                     (partial-derivatives operation a b index (and da t) (and db t) #'emit-once)
                   (setf (svref changes index)
                         (joined (and da by-a (scaled-changes by-a da)) (and db by-b (scaled-changes by-b db)))))))
      (loop for result in (program-results program)
            for place from 0
            do (loop for (input . change) in (changes-of result)
                     do (push change results)
                        (push (cons place input) places)))
      (values (make-program :instructions (coerce (reverse code) 'simple-vector) :results (nreverse results)
                            :guards (program-guards program))
              (nreverse places)))))

(defun partial-derivatives (operation a b index by-a-p by-b-p emit)
  "The operands of the derivatives of an instruction, at INDEX, by its operands A and B; EMIT writes an instruction."
  (let ((one '(:number . 1)) (minus-one '(:number . -1)))
    (macrolet ((put (operation &rest operands) `(funcall emit ,operation ,@operands)))
      (flet ((square (x) (put :multiply x x))
             (under (x) (put :divide one x)))
        (ecase operation
          (:add (list one one))
          (:subtract (list one minus-one))
          (:multiply (list b a))
          (:divide (list (and by-a-p (under b))
                         (and by-b-p (put :negate (put :divide index b)))))
          (:negate (list minus-one nil))
          (:sqrt (list (put :divide '(:number . 1/2) index) nil))
          (:sin (list (put :cos a) nil))
          (:cos (list (put :negate (put :sin a)) nil))
          (:tan (list (put :add one (square index)) nil))
          (:exp (list index nil))
          (:log (list (under a) nil))
          (:expt (list (and by-a-p (put :multiply b (put :expt a (put :subtract b one))))
                       (and by-b-p (put :multiply index (put :log a)))))
          (:asin (list (under (put :sqrt (put :subtract one (square a)))) nil))
          (:acos (list (put :negate (under (put :sqrt (put :subtract one (square a))))) nil))
          (:atan (list (under (put :add one (square a))) nil))
          (:atan2 (let ((radius (put :add (square a) (square b))))
                    (list (put :divide b radius) (put :negate (put :divide a radius)))))
          (:sinh (list (put :cosh a) nil))
          (:cosh (list (put :sinh a) nil))
          (:tanh (list (put :subtract one (square index)) nil))
          (:asinh (list (under (put :sqrt (put :add one (square a)))) nil))
          (:acosh (list (under (put :sqrt (put :subtract (square a) one))) nil))
          (:atanh (list (under (put :subtract one (square a))) nil))
          ((:erf :erfc)
           (let ((slope (put :multiply (put :divide '(:number . 2) (put :sqrt '(:constant . maxima::$%pi)))
                             (put :exp (put :negate (square a))))))
             (list (if (eq operation :erf) slope (put :negate slope)) nil)))
          (:abs (list (put :signum a) nil))
          ((:signum :floor) (list nil nil))
          ((:max :min)
           (let* ((side (put :multiply '(:number . 1/2) (put :signum (put :subtract a b))))
                  (a-larger (put :add '(:number . 1/2) side)) (b-larger (put :subtract '(:number . 1/2) side)))
             (if (eq operation :max) (list a-larger b-larger) (list b-larger a-larger)))))))))

;;; The field

(defun field-derivatives (model)
  "A function (in matrix) that writes the derivatives of the rates of MODEL by its states to MATRIX, by rows; on the
sides that IN holds."
  (if (model-arrangement model) (implicit-derivatives model) (explicit-derivatives model)))

(defun derivative-registers (model)
  "Registers of the derivatives of the equations by the states, and their places."
  (multiple-value-bind (program places) (differentiated-program (model-program model) (model-dimension model))
    (values (registers-for program (length (model-inputs model))) places)))

(defun run-with-inputs (registers in)
  (declare (type (simple-array double-float (*)) in))
  (let ((numbers (registers-numbers registers)) (count (registers-inputs registers)))
    (declare (type (simple-array double-float (*)) numbers) (fixnum count))
    (for (i count) (setf (aref numbers i) (aref in i)))
    (run-registers registers)
    nil))

(defun explicit-derivatives (model)
  (multiple-value-bind (registers pairs) (derivative-registers model)
    (let* ((n (model-dimension model)) (results (registers-results registers))
           (targets (places (loop for (row . column) in pairs collect (+ column (* n row))))))
      (declare (type (simple-array fixnum (*)) results targets))
      (lambda (in matrix)
        (declare (type (simple-array double-float (*)) matrix))
        (run-with-inputs registers in)
        (fill matrix 0d0)
        (let ((numbers (registers-numbers registers)))
          (declare (type (simple-array double-float (*)) numbers))
          (for (k (length targets))
            (setf (aref matrix (aref targets k)) (aref numbers (aref results k)))))
        nil))))

;; The entries are those of A, then right sides, then the unknowns that are quotients (arrangement.lisp).
(defun implicit-derivatives (model)
  "The rates are velocities, and the first unknowns of A u = b."
  (multiple-value-bind (registers places) (derivative-registers model)
    (let* ((n (model-dimension model)) (arrangement (model-arrangement model)) (solved (model-solved model))
           (size (elimination-size (arrangement-elimination arrangement)))
           (unknowns (length (arrangement-sources arrangement)))
           (entries (zeros (length (arrangement-equations arrangement)))) (changed (copy-seq entries))
           (count (- (length entries) unknowns))
           (terms (terms-of-entries arrangement size count))
           (by-state (results-by-state places n))
           (solution (zeros unknowns)) (change (zeros unknowns))
           (solve (unknowns-function arrangement
                                     (lambda (in out) (declare (ignore in)) (replace (the double-array out) changed))
                                     '() unknowns))
           (numbers (registers-numbers registers)) (results (registers-results registers)))
      (declare (type double-array entries changed solution change numbers))
      (flet ((note-changes (state)
               (replace changed entries)
               (fill changed 0d0 :start count)
               (loop for (place . result) in (svref by-state state)
                     for derivative = (aref numbers (aref results result))
                     do (if (>= place count)
                            (incf (aref changed place) derivative)
                            (loop for (row . unknown) in (svref terms place)
                                  do (decf (aref changed (+ count row)) (* derivative (aref solution unknown))))))))
        (lambda (in matrix)
          (declare (type double-array matrix))
          (fill matrix 0d0)
          (loop for place in (model-places model) for row from 0 do (setf (aref matrix (+ place (* n row))) 1d0))
          (funcall (the function (model-system model)) in entries)
          (funcall (the function (model-solver model)) in solution)
          (run-with-inputs registers in)
          (dotimes (state n)
            (when (svref by-state state)
              (note-changes state)
              (funcall (the function solve) in change)
              (loop for k from solved below n
                    do (setf (aref matrix (+ state (* n k))) (aref change (- k solved)))))))))))

(defun results-by-state (places n)
  "For each state, pairs of the place of an entry and the number of the result that is its derivative by that state."
  (let ((by-state (make-array n :initial-element '())))
    (loop for (place . state) in places for result from 0 do (push (cons place result) (svref by-state state)))
    by-state))

(defun terms-of-entries (arrangement size count)
  "For each of the COUNT entries of A, where it stands: pairs of a row and an unknown."
  (let* ((elimination (arrangement-elimination arrangement)) (rows (elimination-rows elimination))
         (unknowns (coupled-unknowns arrangement size count)) (terms (make-array count)))
    (dotimes (k count terms)
      (multiple-value-bind (i j)
          (if rows (values (aref rows k) (aref (elimination-columns elimination) k)) (floor k size))
        (setf (svref terms k)
              (cons (cons i (svref unknowns j))
                    (and (elimination-symmetric elimination) (/= i j) (list (cons j (svref unknowns i))))))))))

(defun coupled-unknowns (arrangement size count)
  "For each of the SIZE unknowns that are solved for, its place among all."
  (let ((unknowns (make-array size)))
    (loop for source across (arrangement-sources arrangement)
          for unknown from 0
          for number = (if (minusp source) (- -1 source count) source)
          do (when (< number size) (setf (svref unknowns number) unknown)))
    unknowns))
