;;; anmech: straight-line programs run in doubles without being compiled.
;;;
;;; The numbers of a program stand in one array, its registers: first the inputs, then the values of the instructions,
;;; then the constants.  An instruction is four fixnums: the operation, its operands, its place.  No number is boxed, so
;;; this takes some ten times as long as compiled code, where a compiler takes as long as a million instructions.
;;;
;;; Entry points: the structure REGISTERS with REGISTERS-NUMBERS, REGISTERS-RESULTS; REGISTERS-FOR, RUN-REGISTERS,
;;; RESULT-LIST.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/codegen" "numerics/operations" "numerics/sharing")

(defstruct (registers (:print-function print-registers))
  (numbers nil :type double-array)
  (codes nil :type (simple-array fixnum (*)))
  (results nil :type (simple-array fixnum (*)))      ; the places of the results
  (inputs 0 :type fixnum)                            ; how many there are
  (overflowing nil)                                  ; whether their numbers may overflow, which may be no harm
  guards)

(defun print-registers (registers stream depth)
  (declare (ignore registers depth))
  (write-string "..." stream))

(defmacro define-operations (name operations)
  "*OPERATIONS-OF-REGISTERS* lists OPERATIONS; NAME is a function (operation a b guards index) of one by its place."
  `(progn
     (defparameter *operations-of-registers* ',operations)
     (declaim (inline ,name))
     (defun ,name (operation a b guards index)
       (declare (fixnum operation index) (double-float a b))
       (the double-float
            (case operation
              ,@(loop for operation in operations
                      for place from 0
                      for domain = (second (assoc operation *domains*))
                      for form = (operation-form operation 'a 'b)
                      collect `(,place ,(if domain
                                            `(if ,domain ,form (the double-float (leave-domain guards index)))
                                            form)))
              (t 0d0))))))

(define-operations result-of-operation
    (:multiply :add :subtract :divide :negate :sqrt :sin :cos :tan :exp :log :expt :asin :acos :atan :atan2 :sinh :cosh
     :tanh :asinh :acosh :atanh :erf :erfc :abs :signum :floor :max :min))

(defun registers-for (program count)
  "Registers of PROGRAM, which has COUNT inputs."
  (let* ((instructions (program-instructions program)) (size (length instructions))
         (codes (make-array (* 4 size) :element-type 'fixnum)) (constants '()) (next (+ count size)))
    (labels ((constant-place (operand)
               (let ((number (number-of-operand operand)))
                 (or (cdr (assoc number constants))
                     (prog1 next (push (cons number next) constants) (incf next)))))
             (place (operand)
               (cond ((null operand) 0)
                     ((integerp operand) (+ count operand))
                     ((eq :input (car operand)) (cdr operand))
                     (t (constant-place operand)))))
      (dotimes (index size)
        (destructuring-bind (operation a &optional b) (aref instructions index)
          (replace codes (list (position operation *operations-of-registers*) (place a) (place b) (+ count index))
                   :start1 (* 4 index))))
      (let* ((places (mapcar #'place (program-results program)))
             (numbers (make-array next :element-type 'double-float :initial-element 0d0)))
        (loop for (number . place) in constants do (setf (aref numbers place) number))
        (make-registers :numbers numbers :codes codes :inputs count :guards (program-guards program)
                        :overflowing (overflowing-p instructions)
                        :results (make-array (length places) :element-type 'fixnum :initial-contents places))))))

(defun run-instructions-of (registers)
  (let ((numbers (registers-numbers registers)) (codes (registers-codes registers))
        (guards (registers-guards registers)))
    (declare (type (simple-array double-float (*)) numbers) (type (simple-array fixnum (*)) codes))
    (with-fast-arithmetic
      (let ((place 0) (end (length codes)))
        (declare (fixnum place end))
        (loop
          (when (>= place end) (return nil))
          (setf (aref numbers (aref codes (fix (+ place 3))))
                (result-of-operation (aref codes place)
                                     (aref numbers (aref codes (fix (+ place 1))))
                                     (aref numbers (aref codes (fix (+ place 2))))
                                     guards
                                     (the fixnum (ash place -2))))
          (setq place (fix (+ place 4))))))))

(defun run-registers (registers)
  "Run the program with the inputs that stand in the first places of its numbers."
  (let ((numbers (registers-numbers registers)))
    (declare (type (simple-array double-float (*)) numbers) (ignorable numbers))
    (if (registers-overflowing registers)
        (with-infinities (run-instructions-of registers))
        (run-instructions-of registers))
    #-gcl (unless (every (lambda (place) (<= (abs (aref numbers place)) most-positive-double-float))
                         (registers-results registers))
            (error 'arithmetic-error))
    nil))

(defun result-list (registers)
  (let ((numbers (registers-numbers registers)) (places (registers-results registers)) (list '()))
    (declare (type (simple-array double-float (*)) numbers) (type (simple-array fixnum (*)) places))
    (with-fast-arithmetic
      (for (k (length places)) (push (aref numbers (aref places k)) list))
      (nreverse list))))
