;;; anmech: equations of motion as functions of numbers.
;;;
;;; The equations are  A u = b,  entries of A and b in the states, the time and the parameters; or they give the rates.
;;; A model has them twice: compiled, as functions of doubles, and as a straight-line program (sharing.lisp), which
;;; knows no arithmetic: who wants them in other numbers, or their derivatives, runs it with numbers of his own type
;;; (PROGRAM-FUNCTION in evaluation.lisp) or goes through its instructions.
;;;
;;; A *field* is a function (in out) of double arrays: IN holds the n states, the time, and the parameters; OUT receives
;;; the n rates.  Where the equations have kinks or jumps, the program and the *smooth field* made of it also have the
;;; sides of the surfaces where these lie as inputs, after the parameters (surfaces.lisp); the plain field finds the
;;; sides itself, and notes them in IN.
;;;
;;; Entry points: the structure MODEL with MODEL-FIELD, MODEL-SMOOTH-FIELD, MODEL-SURFACES, MODEL-SOLVER, MODEL-PROGRAM,
;;; MODEL-EXACT-PROGRAM, MODEL-INPUTS, PLAIN-INPUTS, MODEL-DIMENSION, MODEL-TIMED-P; NOISY-SMOOTH-FIELD, FIELD-FINDING-SIDES,
;;; PRINT-DOTS; $anmech_motion_model.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/dag" "numerics/progress"
       "numerics/sharing" "numerics/surfaces")

(defstruct (model (:print-function print-dots))
  states          ; jets, as many as the field has rates
  time
  parameters      ; symbols; the inputs of code and program are the states, the time, the parameters, and the sides
  surfaces        ; where the equations have kinks; nil: nowhere
  unknowns        ; jets of the highest derivatives, then the multipliers
  equations       ; the entries of A by rows, then those of b; or the rates; as they were given
  program         ; what they are computed by, its constants those of doubles
  exact           ; MODEL-EXACT-PROGRAM, as soon as somebody has asked for it
  smooth-field    ; function (in out): the rates on the sides that IN holds
  field           ; the same on the sides where IN lies, which are noted there
  solver          ; function (in out): the unknowns on the sides that IN holds
  (size 0)        ; the number of linear equations A u = b; 0 if the rates are given
  solved          ; the place from which on rates are the first unknowns
  system          ; function (in array): the entries of A and b
  places          ; where the velocities of the first states stand
  seconds)        ; what compiling took, until a motion tells of it

(defun print-dots (object stream depth)
  (declare (ignore object depth))
  (write-string "..." stream))

(defun model-dimension (model) (length (model-states model)))

(defun model-timed-p (model)
  "Whether the equations depend on time."
  (let ((time (cons :input (model-dimension model))) (program (model-program model)) (surfaces (model-surfaces model)))
    (flet ((time-p (operand) (equal operand time)))
      (or (some #'time-p (program-results program))
          (some (lambda (instruction) (some #'time-p (rest instruction))) (program-instructions program))
          (and surfaces (notevery (lambda (g) (maxima::$freeof (model-time model) g)) (surfaces-where surfaces)))))))

(defun plain-inputs (model)
  (append (model-states model) (list (model-time model)) (model-parameters model)))

(defun model-inputs (model)
  (append (plain-inputs model) (side-inputs (model-surfaces model))))

(defun model-exact-program (model)
  "The program of the equations for numbers of any precision: sqrt(2) and %pi are left to the arithmetic."
  (or (model-exact model)
      (setf (model-exact model)
            (expressions-program (general-forms (model-equations model)) (plain-inputs model) :round-constants nil))))

(defun make-motion-model (states velocities time parameters unknowns equations size)
  "The first of STATES are coordinates with VELOCITIES, states too; the rates of the others are the first unknowns.
EQUATIONS are the entries of A and b of SIZE equations; or, with SIZE 0, the rates."
  (let* ((start (get-internal-real-time))
         (model (make-model :states states :time time :parameters parameters :unknowns unknowns :equations equations
                            :size size :solved (length velocities)))
         (n (- (length states) (length velocities))))
    (flet ((place (velocity) (position velocity states)))
      (with-compilation-errors
        (lambda ()
          (multiple-value-bind (smooth surfaces)
              (smooth-on-sides (general-forms equations) (append states (list time)))
            (setf (model-surfaces model) (compiled-surfaces surfaces (plain-inputs model) (append states (list time))))
            (multiple-value-bind (system program) (compile-expressions smooth (model-inputs model))
              (setf (model-system model) system
                    (model-program model) program)))))
      (let ((system (model-system model)))
        (setf (model-places model) (mapcar #'place velocities)
              (model-smooth-field model)
              (if (zerop size) system (make-implicit-field (model-places model) n size system))
              (model-field model) (field-finding-sides (model-smooth-field model) model)
              (model-solver model) (if (zerop size) system (make-implicit-field '() size size system))
              (model-seconds model) (seconds-since start))))
    model))

(defun field-finding-sides (smooth-field model)
  "SMOOTH-FIELD, called with the sides where its input lies."
  (let ((surfaces (model-surfaces model)))
    (if surfaces
        (lambda (in out) (funcall (the function smooth-field) (put-signs surfaces in) out))
        smooth-field)))

(defun noisy-smooth-field (model direction)
  "The smooth field, with every entry of A and b changed by a unit in the last place, of a sign that depends on the
entry and, 1 or -1, on DIRECTION."
  (let ((size (model-size model)))
    (if (zerop size)
        (model-smooth-field model)
        (make-implicit-field (model-places model) (- (model-dimension model) (length (model-places model))) size
                             (noisy-system (model-system model) (* size (1+ size)) direction)))))

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

(maxima::defmfun maxima::$anmech_motion_model (states velocities time parameters unknowns equations size)
  "anmech_motion_model(states, velocities, time, parameters, unknowns, equations, size): compiled equations of motion."
  (make-motion-model (rest states) (rest velocities) time (rest parameters) (rest unknowns) (rest equations) size))
