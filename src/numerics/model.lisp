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
;;; MODEL-EXACT-PROGRAM, MODEL-INPUTS, PLAIN-INPUTS, MODEL-DIMENSION, MODEL-TIMED-P, MODEL-WORK; HASTEN-FIELD,
;;; WITH-INFINITIES-OF, NOISY-SMOOTH-FIELD, FIELD-FINDING-SIDES; PRINT-DOTS; $anmech_motion_model.

(in-package :anmech)
(needs "algebra/kinks" "algebra/terms" "arithmetic/floats" "numerics/arrangement" "numerics/codegen" "numerics/dag"
       "numerics/noise" "numerics/operations" "numerics/progress" "numerics/sharing" "numerics/surfaces")

(defstruct (model (:print-function print-dots))
  states          ; jets, as many as the field has rates
  time
  parameters      ; symbols; the inputs of code and program are the states, the time, the parameters, and the sides
  surfaces        ; where the equations have kinks; nil: nowhere
  unknowns        ; jets of the highest derivatives, then the multipliers
  given           ; where there are kinks: the entries of A by rows, then those of b, or the rates, as they were given
  equations       ; the entries of A u = b as the arrangement has them; or the rates; on the sides of surfaces
  program         ; what they are computed by, its constants those of doubles
  exact           ; MODEL-EXACT-PROGRAM, as soon as somebody has asked for it
  (series '())    ; of series_program.lisp: what it has made of the model
  smooth-field    ; function (in out): the rates on the sides that IN holds
  field           ; the same on the sides where IN lies, which are noted there
  solver          ; function (in out): the unknowns on the sides that IN holds
  arrangement     ; of A u = b (arrangement.lisp); nil if the rates are given
  solved          ; the place from which on rates are the first unknowns
  system          ; function (in array): the equations' values
  places          ; where the velocities of the first states stand
  timed-p         ; whether the equations depend on time
  (evaluations 0) ; of the field, by motions that have ended; see HASTEN-FIELD
  (meter nil)     ; what measures the grains of its states (weights.lisp), as soon as somebody has asked for it
  (readers '())   ; pairs of what was asked of motions and what reads it (motion_reading.lisp), the last one first
  (pace nil)      ; of motions that are made together: seconds for a unit of time of each, and how many have told that
  seconds)        ; what compiling took, until a motion tells of it

(defun print-dots (object stream depth)
  (declare (ignore object depth))
  (write-string "..." stream))

(defun model-dimension (model) (length (model-states model)))

(defun depends-on-time-p (model)
  (let ((time (cons :input (model-dimension model))) (program (model-program model)) (surfaces (model-surfaces model)))
    (flet ((time-p (operand) (equal operand time)))
      (or (some #'time-p (program-results program))
          (some (lambda (instruction) (some #'time-p (rest instruction))) (program-instructions program))
          (and surfaces (notevery (lambda (g) (maxima::$freeof (model-time model) g)) (surfaces-where surfaces)))))))

(defun plain-inputs (model)
  (append (model-states model) (list (model-time model)) (model-parameters model)))

(defun model-work (model)
  "About how many operations the rates take."
  (+ (length (program-instructions (model-program model)))
     (if (model-arrangement model) (solving-work (model-arrangement model)) 0)))

(defmacro with-infinities-of ((model) &body body)
  "BODY, with infinities throughout where those of MODEL are wanted: at each call of the field they would take longer
than the field."
  `(flet ((go-on () ,@body))
     (if (overflowing-p (program-instructions (model-program ,model))) (with-infinities (go-on)) (go-on))))

(defun model-inputs (model)
  (append (plain-inputs model) (side-inputs (model-surfaces model))))

(defun model-exact-program (model)
  "The program of the equations for numbers of any precision: sqrt(2) and %pi are left to the arithmetic; kinks, too."
  (or (model-exact model)
      (setf (model-exact model)
            (with-compilation-errors
              (lambda ()
                (if (model-surfaces model)
                    (expressions-program (model-given model) (plain-inputs model) :round-constants nil)
                    (expressions-program (general-forms (model-equations model)) (model-inputs model)
                                         :round-constants nil)))))))

(defun make-motion-model (states velocities time parameters unknowns matrix right)
  "The first of STATES are coordinates with VELOCITIES, states too; the rates of the others are the first unknowns.
MATRIX, a list of rows, times them is RIGHT; or they are RIGHT, and MATRIX is nil."
  (let* ((start (get-internal-real-time))
         (varying (append states (list time)))
         (matrix (mapcar (lambda (row) (without-floors row varying)) matrix))
         (right (without-floors right varying))
         (model (make-model :states states :time time :parameters parameters :unknowns unknowns
                            :solved (length velocities)
                            :places (mapcar (lambda (velocity) (position velocity states)) velocities))))
    (with-compilation-errors
      (lambda ()
        (if (some (lambda (row) (some (lambda (form) (some-part #'kinked-operator-p form)) row)) (cons right matrix))
            (compile-on-sides model (append (loop for row in matrix append row) right) (length matrix))
            (compile-equations model matrix right))))
    (setf (model-field model) (field-finding-sides (model-smooth-field model) model)
          (model-timed-p model) (depends-on-time-p model)
          (model-seconds model) (seconds-since start))
    model))

(defun without-floors (forms varying)
  (mapcar (lambda (form) (floors-by-signs form varying)) (general-forms forms)))

(defun compile-on-sides (model given size)
  "GIVEN, with kinks: the entries of the matrix of SIZE equations by rows, then the right sides; with SIZE 0 the rates."
  (let ((varying (append (model-states model) (list (model-time model)))))
    (multiple-value-bind (smooth surfaces) (smooth-on-sides given varying)
      (setf (model-given model) given
            (model-surfaces model) (compiled-surfaces surfaces (plain-inputs model) varying))
      (compile-equations model
                         (loop for row from 0 below size collect (subseq smooth (* row size) (* (1+ row) size)))
                         (nthcdr (* size size) smooth)))))

(defun compile-equations (model matrix right)
  (if matrix
      (multiple-value-bind (arrangement unknowns)
          (arranged-equations matrix right (model-inputs model) (1+ (model-dimension model)))
        (if arrangement (compile-implicit model arrangement) (compile-explicit model unknowns)))
      (compile-explicit model right)))

(defun solved-count (model)
  "How many rates are unknowns."
  (- (model-dimension model) (model-solved model)))

(defun compile-explicit (model unknowns)
  "MODEL from expressions for its UNKNOWNS, of which the first are rates; the others are multipliers that follow."
  (let* ((count (solved-count model))
         (rates (append (mapcar (lambda (place) (nth place (model-states model))) (model-places model))
                        (subseq unknowns 0 count))))
    (multiple-value-bind (field program) (compile-expressions rates (model-inputs model))
      (setf (model-equations model) rates
            (model-program model) program
            (model-system model) field
            (model-smooth-field model) field
            (model-solver model) (if (> (length unknowns) count)
                                     (values (compile-expressions unknowns (model-inputs model)))
                                     (last-of-field field (model-solved model) (model-dimension model)))))))

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
        (model-smooth-field model) (implicit-field model (model-system model))
        (model-solver model) (unknowns-function arrangement (model-system model) '()
                                                (length (model-unknowns model)))))

(defun implicit-field (model system)
  (unknowns-function (model-arrangement model) system (model-places model) (solved-count model)))

(defparameter *worth-compiling* 1000000 "After so many evaluations of a field another million is to be expected.")

(defun hasten-field (model count)
  "COUNT more evaluations of MODEL's field were made.  When they are many, it is compiled once more, all in one."
  (let ((before (model-evaluations model)))
    (incf (model-evaluations model) count)
    (when (and (< before *worth-compiling*) (>= (model-evaluations model) *worth-compiling*) (compiler-p))
      (let ((field (and (model-arrangement model)
                        (unknowns-function-in-one (model-arrangement model) (model-places model)
                                                  (solved-count model)))))
        (when field
          (setf (model-smooth-field model) field
                (model-field model) (field-finding-sides field model)))))))

(defun field-finding-sides (smooth-field model)
  "SMOOTH-FIELD, called with the sides where its input lies."
  (let ((surfaces (model-surfaces model)))
    (if surfaces
        (lambda (in out) (funcall (the function smooth-field) (put-signs surfaces in) out))
        smooth-field)))

(defun noisy-smooth-field (model direction)
  "The smooth field, with every entry of A and b changed by a unit in the last place, to the side that DIRECTION, 1 or
-1, gives the first."
  (if (model-arrangement model)
      (implicit-field model (noisy-system (model-system model) (length (model-equations model))
                                          (arrangement-signs (model-arrangement model)) direction))
      (model-smooth-field model)))

(maxima::defmfun maxima::$anmech_motion_model (states velocities time parameters unknowns matrix right)
  "anmech_motion_model(states, velocities, time, parameters, unknowns, A, b): compiled equations of motion A u = b; with
false for A those of u = b."
  (make-motion-model (rest states) (rest velocities) time (rest parameters) (rest unknowns)
                     (and matrix (mapcar #'rest (rest matrix))) (rest right)))
