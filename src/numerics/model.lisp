;;; anmech: equations of motion as functions of numbers.
;;;
;;; The equations are  A u = b,  entries of A and b in the states, the time and the parameters; or they give the rates.
;;; A model has them twice: compiled, as functions of doubles, and as a straight-line program (sharing.lisp), which
;;; knows no arithmetic: who wants them in other numbers, or their derivatives, runs it with numbers of his own type
;;; (PROGRAM-FUNCTION in evaluation.lisp) or goes through its instructions.
;;;
;;; A *field* is a function (in out) of double arrays: IN holds the n states, the time, and the parameters; OUT receives
;;; the n rates.
;;;
;;; Entry points: the structure MODEL with MODEL-FIELD, MODEL-SOLVER, MODEL-PROGRAM, MODEL-EXACT-PROGRAM, MODEL-INPUTS,
;;; MODEL-DIMENSION, MODEL-TIMED-P, MODEL-WORK, MODEL-FIELD-WITH-NOISE; PRINT-DOTS; $anmech_motion_model.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/arrangement" "numerics/codegen" "numerics/dag" "numerics/progress"
       "numerics/sharing")

(defstruct (model (:print-function print-dots))
  states          ; jets, as many as the field has rates
  time
  parameters      ; symbols; the inputs of all code and programs are the states, the time and the parameters
  unknowns        ; jets of the highest derivatives, then the multipliers
  equations       ; the entries of A u = b as the arrangement has them; or the rates
  program         ; what they are computed by, its constants those of doubles
  exact           ; MODEL-EXACT-PROGRAM, as soon as somebody has asked for it
  field           ; function (in out): the rates
  solver          ; function (in out): the unknowns
  arrangement     ; of A u = b (arrangement.lisp); nil if the rates are given
  solved          ; the place from which on rates are the first unknowns
  system          ; function (in array): the equations' values
  places          ; where the velocities of the first states stand
  (readers '())   ; pairs of what was asked of motions and what reads it (motion_reading.lisp), the last one first
  seconds)        ; what compiling took, until a motion tells of it

(defun print-dots (object stream depth)
  (declare (ignore object depth))
  (write-string "..." stream))

(defun model-dimension (model) (length (model-states model)))

(defun model-timed-p (model)
  "Whether the equations depend on time."
  (let ((time (cons :input (model-dimension model))) (program (model-program model)))
    (flet ((time-p (operand) (equal operand time)))
      (or (some #'time-p (program-results program))
          (some (lambda (instruction) (some #'time-p (rest instruction))) (program-instructions program))))))

(defun model-work (model)
  "About how many operations the rates take."
  (+ (length (program-instructions (model-program model)))
     (if (model-arrangement model) (solving-work (model-arrangement model)) 0)))

(defun model-inputs (model)
  (append (model-states model) (list (model-time model)) (model-parameters model)))

(defun model-exact-program (model)
  "The program of the equations for numbers of any precision: sqrt(2) and %pi are left to the arithmetic."
  (or (model-exact model)
      (setf (model-exact model)
            (expressions-program (general-forms (model-equations model)) (model-inputs model) :round-constants nil))))

(defun make-motion-model (states velocities time parameters unknowns matrix right)
  "The first of STATES are coordinates with VELOCITIES, states too; the rates of the others are the first unknowns.
MATRIX, a list of rows, times them is RIGHT; or they are RIGHT, and MATRIX is nil."
  (let* ((start (get-internal-real-time))
         (model (make-model :states states :time time :parameters parameters :unknowns unknowns
                            :solved (length velocities)
                            :places (mapcar (lambda (velocity) (position velocity states)) velocities))))
    (with-compilation-errors
      (lambda ()
        (if matrix
            (multiple-value-bind (arrangement unknowns)
                (arranged-equations matrix right (model-inputs model) (1+ (length states)))
              (if arrangement (compile-implicit model arrangement) (compile-explicit model unknowns)))
            (compile-explicit model right))))
    (setf (model-seconds model) (seconds-since start))
    model))

(defun solved-count (model)
  "How many rates are unknowns."
  (- (model-dimension model) (model-solved model)))

(defun compile-explicit (model unknowns)
  "MODEL from expressions for its UNKNOWNS, which are rates all of them: where there are multipliers they are coupled."
  (let ((rates (append (mapcar (lambda (place) (nth place (model-states model))) (model-places model)) unknowns)))
    (multiple-value-bind (field program) (compile-expressions rates (model-inputs model))
      (setf (model-equations model) rates
            (model-program model) program
            (model-system model) field
            (model-field model) field
            (model-solver model) (last-of-field field (model-solved model) (model-dimension model))))))

(defun last-of-field (field start end)
  "A function (in out): the rates from START on."
  (declare (type function field))
  (if (zerop start)
      field
      (let ((rates (make-array end :element-type 'double-float)))
        (lambda (in out)
          (funcall field in rates)
          (replace out rates :start2 start)))))

(defun compile-implicit (model arrangement)
  (setf (model-arrangement model) arrangement
        (model-equations model) (arrangement-equations arrangement)
        (model-program model) (arrangement-program arrangement)
        (model-system model) (arrangement-system arrangement)
        (model-field model) (implicit-field model (model-system model))
        (model-solver model) (unknowns-function arrangement (model-system model) '()
                                                (length (model-unknowns model)))))

(defun implicit-field (model system)
  (unknowns-function (model-arrangement model) system (model-places model) (solved-count model)))

(defun model-field-with-noise (model direction)
  "The field, with every entry of A and b changed by a unit in the last place, of a sign that depends on the entry and,
1 or -1, on DIRECTION."
  (if (model-arrangement model)
      (implicit-field model (noisy-system (model-system model) (length (model-equations model)) direction))
      (model-field model)))

(defun noisy-system (system count direction)
  (declare (type function system) (fixnum count))
  (let ((factors (make-array count :element-type 'double-float)) (seed 1))
    (declare (fixnum seed))
    (dotimes (k count)
      (setq seed (mod (* 16807 seed) 2147483647))
      (setf (aref factors k) (+ 1d0 (* 2.3d-16 direction (if (logbitp 10 seed) 1 -1)))))
    (lambda (in work)
      (declare (type (simple-array double-float (*)) work factors))
      (funcall system in work)
      (with-fast-arithmetic
        (for (k count) (setf (aref work k) (flo (* (aref factors k) (aref work k)))))
        nil))))

(maxima::defmfun maxima::$anmech_motion_model (states velocities time parameters unknowns matrix right)
  "anmech_motion_model(states, velocities, time, parameters, unknowns, A, b): compiled equations of motion A u = b; with
false for A those of u = b."
  (make-motion-model (rest states) (rest velocities) time (rest parameters) (rest unknowns)
                     (and matrix (mapcar #'rest (rest matrix))) (rest right)))
