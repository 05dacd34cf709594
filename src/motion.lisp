;;; Motions: fields made of equations, integration to a wanted accuracy of the result, and what can be read off it.
;;;
;;; Entry points: $anmech_motion_model, $anmech_motion, $anmech_motion_rows, $anmech_evaluate, $anmech_double.
;;;
;;; A method of integration bounds the error of one step; what a user asks for is an error of the whole. So a motion is
;;; integrated twice, the second time with a tolerance ten times coarser, and both are compared at every step; if they differ
;;; by more than was asked for, both are done again with a finer tolerance.  The difference is the error of the coarser
;;; motion, and the finer one is handed out: the estimate is on the safe side.  The coarser one starts besides from
;;; the other neighbouring doubles wherever a given number had to be rounded, so that the estimate also holds what that
;;; rounding does in the end.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4; L. F.
;;; Shampine, Tolerance proportionality in ODE codes, Lecture Notes in Mathematics 1386 (1989) 118-136.

(in-package :anmech)

;;; Numbers

(defun exact-value (form)
  "The rational value of a real number of Maxima, of an irrational one to 40 digits; nil if FORM is no finite number."
  (flet ((rational-of (form)
           (cond ((rationalp form) form)
                 ((floatp form) (to-rational form form))
                 ((operator-p form 'maxima::rat) (/ (second form) (third form)))
                 ((operator-p form 'maxima::bigfloat) (bigfloat-value form)))))
    (handler-case (or (rational-of form)
                      (rational-of (maxima::meval `((maxima::mprog) ((maxima::mlist) ((maxima::msetq) maxima::$fpprec 40))
                                                    ((maxima::$bfloat) ((maxima::mquote) ,form))))))
      (unsupported-expression () nil))))

(defun neighbour (number exact)
  "The double next to NUMBER on the side of EXACT; NUMBER itself where it is exact."
  (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
    (let ((difference (- exact (* sign mantissa (expt 2 exponent)))))
      (if (or (zerop difference) (zerop number))
          number
          (to-double (* (+ (* sign mantissa) (signum difference)) (expt 2 exponent)))))))

(defun doubles (numbers)
  (let ((array (make-array (length numbers) :element-type 'double-float)) (place -1))
    (dolist (number numbers array)
      (setf (aref array (incf place)) number))))

(maxima::defmfun maxima::$anmech_double (form)
  "anmech_double(number): the double next to it; false if it is no finite real number."
  (let ((value (exact-value form)))
    (and value (handler-case (to-double value) (unsupported-expression () nil)))))

;;; Fields

(defstruct (model (:print-function print-dots))
  states          ; jets, as many as the field has rates
  time
  parameters      ; symbols; the inputs of all compiled code are the states, the time and the parameters
  unknowns        ; jets of the highest derivatives, then the multipliers
  field           ; function (in out): the rates
  solver          ; function (in out): the unknowns
  seconds)        ; what compiling took

(defun print-dots (object stream depth)
  "Inside of an expression of Maxima, such an object is shown as dots."
  (declare (ignore object depth))
  (write-string "..." stream))

(defun model-inputs (model)
  (append (model-states model) (list (model-time model)) (model-parameters model)))

(defun seconds-since (start)
  (/ (float (- (get-internal-real-time) start) 1d0) internal-time-units-per-second))

(defun implicit-solver (size system)
  "A function (in out): the SIZE unknowns of A u = b, where SYSTEM writes A by rows and then b."
  (let ((matrix (make-array (* size (1+ size)) :element-type 'double-float))
        (solution (make-array size :element-type 'double-float)))
    (lambda (in out)
      (funcall (the function system) in matrix)
      (replace solution matrix :start2 (* size size))
      (unless (solve-linear-in-place size matrix solution)
        (error 'domain-violation :operation :solve :source nil))
      (replace out solution))))

(defun with-compilation-errors (thunk)
  (handler-case (funcall thunk)
    (unsupported-expression (condition) (complain "~a" (unsupported-sentence condition)))))

(defun make-motion-model (order states time parameters unknowns equations size)
  "EQUATIONS are the entries of A and b of SIZE equations; or, with SIZE 0, the rates."
  (let* ((start (get-internal-real-time))
         (model (make-model :states states :time time :parameters parameters :unknowns unknowns))
         (system (with-compilation-errors (lambda () (compile-expressions equations (model-inputs model)))))
         (solver (if (zerop size) system (implicit-solver size system))))
    (setf (model-solver model) solver
          (model-field model) (if (and (= order 2) (plusp size))
                                  (make-implicit-field (floor (length states) 2) size system)
                                  solver)
          (model-seconds model) (seconds-since start))
    model))

(maxima::defmfun maxima::$anmech_motion_model (order states time parameters unknowns equations size)
  "anmech_motion_model(order, states, time, parameters, unknowns, equations, size): compiled equations of motion."
  (make-motion-model order (rest states) time (rest parameters) (rest unknowns) (rest equations) size))

;;; A motion

(defstruct (motion (:print-function print-dots))
  model
  integration                       ; of the kernel, with dense output
  start                             ; double array: first states, time, parameters
  reached                           ; the time up to which it is given
  error-estimate                    ; nil if not verified
  tolerance                         ; of one step
  (steps 0) (rejected 0)            ; of the integration handed out
  (evaluations 0) (seconds 0d0)     ; of all integrations together
  message                           ; why it is not what was asked for; nil if it is
  (facts '()))                      ; what the layer above notes: pairs (name . value)

(defun motion-dimension (motion) (length (model-states (motion-model motion))))
(defun start-time (motion) (aref (motion-start motion) (motion-dimension motion)))

(defun state-at (motion time in)
  "Write state, time and parameters at TIME to IN."
  (replace in (motion-start motion))
  (dense-value (motion-integration motion) time in)
  (setf (aref in (motion-dimension motion)) time)
  in)

;;; The sizes that errors are measured by

(defstruct weights
  typical        ; of each state: its size early in the motion
  grain)         ; of each state: the size of the terms that it is made of; roundings are a part of it

(defun rate-terms (field in n amplitudes rates)
  "Add to RATES, for each rate, how much it changes in proportion to relative changes of the single states."
  (let ((before (make-array n :element-type 'double-float)) (after (make-array n :element-type 'double-float))
        (part 1d-6) (found (make-array n :element-type 'double-float :initial-element 0d0)))
    (handler-case
        (progn
          (funcall field in before)
          (dotimes (j n)
            (let ((state (aref in j)))
              (setf (aref in j) (+ state (* part (aref amplitudes j))))
              (unwind-protect (funcall field in after)
                (setf (aref in j) state))
              (dotimes (i n)
                (incf (aref found i) (/ (abs (- (aref after i) (aref before i))) part)))))
          (dotimes (i n)
            (setf (aref rates i) (max (aref rates i) (aref found i) (abs (aref before i))))))
      ((or domain-violation arithmetic-error) () nil))))

(defun grain-at (field points n period)
  "The grain of each state: what the terms of its rate give in the time PERIOD.  POINTS are arrays like the input of FIELD.
A second round brings in states that are zero themselves, but whose rates consist of terms that cancel."
  (let ((grain (make-array n :element-type 'double-float :initial-element 0d0)))
    (dotimes (round 2 grain)
      (let ((rates (make-array n :element-type 'double-float :initial-element 0d0)))
        (dolist (point points)
          (rate-terms field point n (map 'double-array (lambda (g state) (max g (abs state))) grain (subseq point 0 n))
                      rates))
        (dotimes (i n)
          (when (< (aref rates i) 1d200)
            (setf (aref grain i) (* period (aref rates i)))))))))

(defun first-weights (field start n t1)
  (let ((grain (grain-at field (list (copy-seq start)) n (* 0.01d0 (abs (- t1 (aref start n)))))))
    (make-weights :grain grain
                  :typical (map 'double-array (lambda (g state) (* 0.1d0 (max g (abs state)))) grain (subseq start 0 n)))))

(defun measured-weights (field start n integration)
  "From a motion that has been integrated: sizes after an eighth of the steps, and the grain at a dozen of points."
  (let* ((steps (integration-steps integration))
         (count (length steps))
         (typical (make-array n :element-type 'double-float :initial-element 0d0))
         (points '()))
    (flet ((state (k i) (aref (the double-array (svref steps k)) (+ 2 (* 8 i)))))
      (loop for k from 0 to (min (floor count 8) (1- count))
            do (dotimes (i n) (setf (aref typical i) (max (aref typical i) (abs (state k i))))))
      (loop for k from 0 below count by (max 1 (ceiling count 12))
            do (let ((point (copy-seq start)))
                 (dotimes (i n) (setf (aref point i) (state k i)))
                 (setf (aref point n) (aref (the double-array (svref steps k)) 0))
                 (push point points))))
    (make-weights :typical typical
                  :grain (grain-at field points n (/ (* 4 (abs (- (integration-time integration)
                                                                  (integration-start integration))))
                                                     (max 1 count))))))

(defparameter *rounding* 1d-16 "The part of the grain below which a difference between two steps is noise.")

(defun tolerances (weights tolerance)
  (map 'double-array (lambda (typical grain) (max (* tolerance typical) (* *rounding* grain)))
       (weights-typical weights) (weights-grain weights)))

;;; Two integrations and their difference

(defstruct comparison
  (error 0d0)                       ; the largest difference of a state, in units of its largest size so far
  (good-until nil))                 ; the last time up to which it was below the wanted accuracy

(defun comparing-observer (reference n weights accuracy comparison)
  "An observer of the coarser integration; REFERENCE is the finer one, with dense output."
  (let* ((state (make-array n :element-type 'double-float))
         (largest (map 'double-array (lambda (grain) (/ (* 10 *rounding* grain) accuracy)) (weights-grain weights)))
         (end (integration-time reference))
         (forward (>= end (integration-start reference)))
         (good t))
    (lambda (in)
      (let ((time (aref in n)))
        (if (if forward (> time end) (< time end))
            :stop
            (let ((worst 0d0))
              (dense-value reference time state)
              (dotimes (i n)
                (setf (aref largest i) (max (aref largest i) (abs (aref state i))))
                (let ((difference (abs (- (aref in i) (aref state i)))))
                  (unless (zerop difference)
                    (setq worst (max worst (/ difference (max (aref largest i) 1d-300)))))))
              (setf (comparison-error comparison) (max worst (comparison-error comparison)))
              (setq good (and good (<= worst accuracy)))
              (when good (setf (comparison-good-until comparison) time))
              nil))))))

(defparameter *coarser* 10d0 "How much coarser the tolerance of the second integration is.")
(defparameter *finest* 2d-15 "The finest tolerance that makes sense.")

(defun integrate-field (model start t1 tolerance weights max-steps progress &key dense observer)
  (dop853 (model-field model) (copy-seq start) (length (model-states model)) t1
          :relative tolerance :absolute (tolerances weights tolerance) :max-steps max-steps :dense dense
          :observer observer :progress progress))

(defun integrate-motion (model start other-start t1 accuracy verify max-steps progress)
  "The motion of MODEL from START, which holds states, time and parameters; OTHER-START is the same, rounded otherwise."
  (let* ((clock (get-internal-real-time))
         (n (length (model-states model)))
         (weights (first-weights (model-field model) start n t1))
         (tolerance (if verify (max (/ accuracy *coarser*) 1d-6) (/ accuracy *coarser*)))
         (best nil) (evaluations 0))
    (loop
      (let* ((fine (integrate-field model start t1 tolerance weights max-steps progress :dense t))
             (comparison (make-comparison :good-until (integration-start fine)))
             (motion (make-motion :model model :integration fine :start start :reached (integration-time fine)
                                  :tolerance tolerance :steps (integration-accepted fine)
                                  :rejected (integration-rejected fine))))
        (incf evaluations (integration-evaluations fine))
        (setq weights (measured-weights (model-field model) start n fine))
        (when verify
          (let ((coarse (integrate-field model other-start t1 (* tolerance *coarser*) weights max-steps progress
                                         :observer (comparing-observer fine n weights accuracy comparison))))
            (incf evaluations (integration-evaluations coarse))
            (setf (motion-error-estimate motion) (comparison-error comparison))))
        (let* ((error (comparison-error comparison))
               (previous (and best (motion-error-estimate best)))
               (last (or (<= error accuracy) (not verify) (<= tolerance *finest*)
                         (eq :too-many-steps (integration-status fine))
                         (and previous (< previous 1d-3) (< (* 0.5d0 previous) error)))))
          (when (or (null best) (< error previous))
            (setq best motion)
            (finish-motion motion comparison accuracy verify))
          (when last (return))
          (setq tolerance (max *finest* (* tolerance (max 1d-4 (min 0.1d0 (/ (* 0.4d0 accuracy) error)))))))))
    (setf (motion-evaluations best) evaluations
          (motion-seconds best) (seconds-since clock))
    best))

(defun finish-motion (motion comparison accuracy verify)
  "Say what is to be said; a motion that ends early is given as far as it is accurate."
  (let* ((integration (motion-integration motion))
         (trouble (integration-message integration))
         (good (or (not verify) (<= (comparison-error comparison) accuracy)))
         (good-until (comparison-good-until comparison)))
    (cond ((and trouble (not good) (/= good-until (integration-start integration)))
           (setf (motion-reached motion) good-until
                 (motion-error-estimate motion) accuracy
                 (motion-message motion) (format nil "~a; the accuracy of ~a is kept up to time ~a" trouble
                                                 (maxima-text accuracy) (maxima-text good-until))))
          (trouble (setf (motion-message motion) trouble))
          ((not good)
           (setf (motion-message motion) (format nil "the accuracy of ~a was not reached, only ~a"
                                                 (maxima-text accuracy)
                                                 (maxima-text (motion-error-estimate motion))))))))

(maxima::defmfun maxima::$anmech_motion (model states interval parameters accuracy verify max-steps progress)
  "anmech_motion(model, states, [t0, t1], parameters, accuracy, verify, max_steps, progress): all numbers exact."
  (let* ((exact (mapcar #'exact-value (append (rest states) (list (second interval)) (rest parameters))))
         (nearest (mapcar #'to-double exact))
         (other (mapcar #'neighbour nearest exact))
         (place (length (rest states))))
    (setf (nth place other) (nth place nearest))      ; one and the same first time
    (integrate-motion model (doubles nearest) (doubles other) (to-double (exact-value (third interval)))
                      (to-double (exact-value accuracy)) verify max-steps (and progress nil))))

;;; Reading a motion

(defun numbers-list (numbers)
  (cons '(maxima::mlist maxima::simp) (coerce numbers 'list)))

(maxima::defmfun maxima::$anmech_motion_note (motion name value)
  "anmech_motion_note(record, name, value): keep a fact about it."
  (push (cons name value) (motion-facts motion))
  value)

(maxima::defmfun maxima::$anmech_motion_fact (motion name)
  "anmech_motion_fact(record, name): what was noted, or one of its own numbers."
  (let* ((noted (assoc name (motion-facts motion))) (model (motion-model motion)))
    (if noted
        (cdr noted)
        (ecase name
          (maxima::$span (numbers-list (list (start-time motion) (motion-reached motion))))
          (maxima::$reached (motion-reached motion))
          (maxima::$states (cons '(maxima::mlist maxima::simp) (model-states model)))
          (maxima::$names (cons '(maxima::mlist maxima::simp) (model-parameters model)))
          (maxima::$parameters (numbers-list (subseq (motion-start motion) (1+ (motion-dimension motion)))))
          (maxima::$error_estimate (or (motion-error-estimate motion) 'maxima::$unknown))
          (maxima::$status (or (motion-message motion) 'maxima::$complete))
          (maxima::$steps (motion-steps motion))
          (maxima::$rejected (motion-rejected motion))
          (maxima::$evaluations (motion-evaluations motion))
          (maxima::$seconds (motion-seconds motion))
          (maxima::$compile_seconds (model-seconds model))))))

;;; Expressions evaluated without compiling: they are few, and evaluated some hundred times

(defun apply-operation (operation a b)
  "The value of OPERATION, nil outside of its domain."
  (declare (double-float a b))
  (macrolet ((cases (&rest names)
               `(ecase operation
                  ,@(loop for name in names
                          collect `(,name (and ,(or (second (assoc name *domains*)) t)
                                               ,(operation-form name 'a 'b)))))))
    (cases :add :subtract :multiply :divide :negate :sqrt :sin :cos :tan :exp :log :expt :asin :acos :atan :atan2 :sinh
           :cosh :tanh :asinh :acosh :atanh :abs :signum :max :min)))

(defun run-program (program in)
  "The list of the results of PROGRAM for the inputs IN."
  (let* ((instructions (program-instructions program))
         (values (make-array (length instructions))))
    (flet ((value (operand)
             (cond ((integerp operand) (svref values operand))
                   ((eq :input (car operand)) (aref in (cdr operand)))
                   (t (cdr operand)))))
      (dotimes (index (length instructions))
        (destructuring-bind (operation a &optional b) (aref instructions index)
          (setf (svref values index)
                (or (apply-operation operation (value a) (if b (value b) 0d0))
                    (leave-domain (program-guards program) index)))))
      (mapcar #'value (program-results program)))))

(defun evaluated (expressions inputs arrays)
  "For each of ARRAYS, values of INPUTS, the list of the values of EXPRESSIONS."
  (let ((program (with-compilation-errors (lambda () (expressions-program expressions inputs)))))
    (handler-case (mapcar (lambda (in) (run-program program in)) arrays)
      (domain-violation (condition) (complain "~a" condition))
      (arithmetic-error () (complain "a value is too large for a double")))))

(defun exact-doubles (numbers)
  (doubles (mapcar (lambda (number) (to-double (exact-value number))) numbers)))

(maxima::defmfun maxima::$anmech_evaluate (expressions variables numbers)
  "anmech_evaluate([expr, ...], [variable, ...], [number, ...]): the list of the values, doubles."
  (numbers-list (first (evaluated (rest expressions) (rest variables) (list (exact-doubles (rest numbers)))))))

(maxima::defmfun maxima::$anmech_correct (equations inputs numbers variables)
  "anmech_correct(equations, inputs, numbers, variables): Newton's method.  EQUATIONS are the entries of A and b of
A u = b in the inputs; the first unknowns are the corrections of the variables, which are among the inputs.  The list of all
numbers, corrected; false if A is singular or the corrections do not fade."
  (let* ((size (isqrt (length (rest equations))))
         (in (exact-doubles (rest numbers)))
         (places (mapcar (lambda (variable) (position variable (rest inputs) :test #'equal)) (rest variables))))
    (loop repeat 50
          do (let* ((entries (doubles (first (evaluated (rest equations) (rest inputs) (list in)))))
                    (solution (subseq entries (* size size)))
                    (largest 0d0))
               (unless (solve-linear-in-place size entries solution) (return nil))
               (loop for place in places
                     for i from 0
                     do (let ((corrected (+ (aref in place) (aref solution i))))
                          (unless (= corrected (aref in place))
                            (setq largest (max largest (/ (abs (aref solution i)) (abs corrected)))))
                          (setf (aref in place) corrected)))
               (when (<= largest 1d-15) (return (numbers-list in))))
          finally (return nil))))

(defun with-unknowns (motion in)
  "IN, followed by the unknowns there."
  (let* ((model (motion-model motion))
         (unknowns (make-array (length (model-unknowns model)) :element-type 'double-float)))
    (funcall (the function (model-solver model)) in unknowns)
    (concatenate 'double-array in unknowns)))

(maxima::defmfun maxima::$anmech_motion_rows (motion expressions times)
  "anmech_motion_rows(motion, [expr, ...], [time, ...]): a list of values for each time.  The expressions may hold the
states, the time, the parameters and the unknowns, in jets; the times are doubles of its interval."
  (let* ((model (motion-model motion))
         (inner (some (lambda (unknown)
                        (notevery (lambda (expression) (maxima::$freeof unknown expression)) (rest expressions)))
                      (model-unknowns model)))
         (arrays (mapcar (lambda (time)
                           (let ((in (state-at motion time (make-array (length (motion-start motion))
                                                                       :element-type 'double-float))))
                             (if inner (with-unknowns motion in) in)))
                         (rest times))))
    (cons '(maxima::mlist maxima::simp)
          (mapcar #'numbers-list
                  (evaluated (rest expressions)
                             (append (model-inputs model) (and inner (model-unknowns model)))
                             arrays)))))

;;; Files

(defun csv-field (text)
  "TEXT as a field of a table, in quotes where a comma would break it."
  (if (find #\, text) (format nil "\"~a\"" text) text))

(maxima::defmfun maxima::$anmech_write_table (file names rows)
  "anmech_write_table(file, [name, ...], [[number, ...], ...]): comma-separated values; the numbers read back exactly."
  (handler-case
      (with-open-file (stream file :direction :output :if-exists :supersede)
        (let ((*read-default-float-format* 'double-float) (*package* (find-package :anmech)))
          (format stream "~{~a~^,~}~%" (mapcar #'csv-field (rest names)))
          (dolist (row (rest rows))
            (format stream "~{~s~^,~}~%" (rest row)))))
    ((or file-error stream-error) () (complain "cannot write the file ~a" file)))
  'maxima::$done)
