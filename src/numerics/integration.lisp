;;; anmech: what methods of integration share: problems, steps and their control, dense output.
;;;
;;; A *problem* is a field with a first state and a last time.  What comes of it is an *integration*: of every step that
;;; was kept, the time at which it begins and something that only the method understands; its function INTERPOLANT gives
;;; the state at any time within the step from that.  So whoever reads an integration knows no method: DENSE-VALUE gives
;;; the state at a time, STATE-OF-STEP that at the beginning of a step.
;;;
;;; A method with an estimate of the error of a step is a *formula*; then all else is done for it, by INTEGRATE-BY-STEPS
;;; (steps.lisp): the first step, the choice of the others, kinks, events, what happens where the field leaves its domain,
;;; the end.  The functions of a formula take a *run*, which holds what they need: see the structures FORMULA and RUN,
;;; and the macro WITH-RUN.  A method that does not go step by step like this makes an integration itself, by
;;; MAKE-INTEGRATION.
;;;
;;; Entry points: the structures PROBLEM, EVENT, TOLERANCE, FORMULA, RUN, INTEGRATION; WITH-RUN, WITH-CONTROL;
;;; DENSE-VALUE, STATE-OF-STEP, STEP-LENGTH, INTEGRATION-START, INTEGRATION-TIME; ZEROS.

(in-package :anmech)
(needs "arithmetic/floats")

;;; Problems

(defstruct problem
  model                             ; for methods that need more than the field: its program, to be differentiated
  field                             ; function (in out) of double arrays
  surfaces smooth-field             ; where it has kinks, and the field on the sides that IN holds; nil: nowhere
  (start nil :type double-array)    ; states, time, parameters, sides
  (n 0 :type fixnum)                ; the number of states
  end                               ; the last time
  timed                             ; whether the field depends on time
  (events '())                      ; see below
  (breakpoints '())                 ; times, in the order of the motion, at which steps end
  longest                           ; the longest step; nil: any
  (noise nil))                      ; factors, one for each state, by which the field sees them changed; nil: none

(defstruct event
  "What is looked for on the way."
  number            ; its place among those that the user has given
  name              ; as it is told of
  function          ; of an array like the input of the field: the value
  direction         ; 1: only where the value grows through zero, -1: where it falls; 0: both
  terminal)         ; at which of its occurrences the motion ends; nil: at none

(defun problem-time (problem) (aref (problem-start problem) (problem-n problem)))

(defstruct tolerance
  "The error that one step may have: of each state, the absolute one and RELATIVE times its size.  OBSERVER is to be
called after every step with the array of its end, like the input of the field: it may let the absolute ones grow."
  relative
  (absolute nil :type double-array)
  observer)

;;; What comes of it

(defstruct integration
  times            ; double array: where the steps that were kept begin, and the time reached
  steps            ; simple vector: what the method keeps of each of them; of the first ones, if there are very many
  interpolant      ; function (step time out n): the state at a time within the step
  (checkpoints #() :type simple-vector)   ; the states where every *REPLAYED*th of the others begins
  replay           ; function (state from to): what the method keeps of these steps, taken again
  (replayed nil)   ; the first place of the steps that were taken again last, and the vector of them
  sides            ; function (point): the sides of surfaces at the time and state in it are noted there; nil: nobody knows
  ended-by         ; the event that has ended it, if one has
  final            ; the state at the time reached
  largest          ; the largest size of each state where steps begin and end; nil if nobody has looked
  accepted rejected evaluations
  status           ; :ok, :stopped, :event, :too-many-steps, :step-too-small, :too-large, :domain, :not-finite or :undetermined
  message)         ; what happened, a sentence; nil if all is well

(defparameter *replayed* 64 "How many steps are taken again at once where they were not kept.")

(defun zeros (size) (make-array size :element-type 'double-float :initial-element 0d0))

(defun integration-start (integration) (aref (the double-array (integration-times integration)) 0))

(defun integration-time (integration)
  "The time reached."
  (let ((times (integration-times integration)))
    (declare (type (simple-array double-float (*)) times))
    (aref times (1- (length times)))))

(defun step-length (integration place)
  (let ((times (integration-times integration)))
    (declare (type (simple-array double-float (*)) times) (fixnum place))
    (- (aref times (1+ place)) (aref times place))))

(defun step-place (times time)
  "The place of the last one of TIMES, but for the very last, that is not beyond TIME."
  (declare (type (simple-array double-float (*)) times) (double-float time))
  (with-fast-arithmetic
    (let* ((count (length times)) (low 0) (high (fix (- count 2)))
           (forward (<= (aref times 0) (aref times (fix (- count 1))))))
      (declare (fixnum count low high))
      (loop
        (unless (< low high) (return low))
        (let* ((middle (the fixnum (ash (fix (+ low high 1)) -1))) (there (aref times middle)))
          (declare (fixnum middle) (double-float there))
          (if (if forward (<= there time) (>= there time))
              (setq low middle)
              (setq high (fix (- middle 1)))))))))

(defun kept-of-step (integration place)
  "What the method keeps of the step at PLACE, which may have to be taken again."
  (let ((steps (integration-steps integration)))
    (declare (simple-vector steps) (fixnum place))
    (if (< place (length steps))
        (svref steps place)
        (multiple-value-bind (block within) (floor (- place (length steps)) *replayed*)
          (svref (replayed-steps integration block) within)))))

(defun replayed-steps (integration block)
  "The steps of the BLOCK after the ones that were kept."
  (let ((first (+ (length (integration-steps integration)) (* block *replayed*))))
    (unless (eql first (car (integration-replayed integration)))
      (setf (integration-replayed integration)
            (cons first (funcall (the function (integration-replay integration))
                                 (svref (integration-checkpoints integration) block)
                                 first
                                 (min (+ first *replayed*) (1- (length (integration-times integration))))))))
    (cdr (integration-replayed integration))))

(defun step-count (integration) (1- (length (the double-array (integration-times integration)))))

(defun dense-value (integration time out)
  "Write the state at TIME, which is between the ends, to OUT."
  (let ((final (integration-final integration)) (time (float time 1d0)))
    (declare (type (simple-array double-float (*)) final))
    (if (zerop (step-count integration))
        (replace out final)
        (funcall (the function (integration-interpolant integration))
                 (kept-of-step integration (step-place (integration-times integration) time)) time out (length final)))
    out))

(defun state-of-step (integration place out)
  "Write the state where the step at PLACE begins to OUT; after the last, that at the end."
  (declare (fixnum place))
  (let* ((kept (length (integration-steps integration))) (later (- place kept)))
    (cond ((= place (step-count integration))
           (replace out (the double-array (integration-final integration))))
          ((and (>= later 0) (zerop (mod later *replayed*)))
           (replace out (the double-array (svref (integration-checkpoints integration) (floor later *replayed*)))))
          (t (funcall (the function (integration-interpolant integration))
                      (kept-of-step integration place)
                      (aref (the double-array (integration-times integration)) place)
                      out
                      (length (integration-final integration)))))
    out))

;;; Formulas and runs

(defstruct formula
  "How a method takes one step.  The first four functions take a run.
BEGIN    before all, and wherever the field changes: makes WORK, computes the rates at the beginning and returns them; or sets the first step
         itself, (control step), and returns nil
ATTEMPT  the state at the end of a step of the length (control step) goes to NEXT, the estimate of its error, in units
         of the tolerance, to (control error): up to 1, the step is good; above 1e200, nothing came of it.  The step may
         be made shorter here.  Conditions of the field pass through
COMPLETE after an attempt that was good: what is kept of the step.  The next attempt begins at its end
SKETCH   the same where the states at the ends of steps are enough: nothing is kept; nil: as COMPLETE
CHOOSE   sets the length of the next step after that; nil: by what is usual (steps.lisp)
VALUE    function (kept time out n): the state at a time within the step goes to OUT; where it begins, that exactly
ROOM     function (n): how many doubles are kept of a step
The same step, taken twice, gives the same: where steps are very many, most are not kept but taken again"
  (order 8 :type fixnum)         ; the error is of this power of the step
  begin attempt complete sketch choose value room)

(defstruct run
  (formula nil :type formula)
  field
  (in nil :type double-array)            ; where the formula puts what the field is to see
  (n 0 :type fixnum)
  (state nil :type double-array)         ; at the beginning of the step
  (next nil :type double-array)          ; at its end
  (largest nil :type double-array)       ; of each state, the largest size so far
  (control nil :type double-array)       ; see WITH-CONTROL
  (absolute nil :type double-array)      ; see TOLERANCE
  work                                   ; the formula's own
  problem
  watcher                                ; of kinks and events (switching.lisp), or nil
  (stops '())                            ; the breakpoints to come
  (beginnings '())                       ; the places of steps before which the field has changed
  (stale nil)                            ; whether the formula must begin again
  (sketch nil)                           ; whether only the states where steps begin are kept
  (accepted 0 :type fixnum)
  (rejected 0 :type fixnum)
  (short 0 :type fixnum)                 ; how many steps without a break were very short
  (evaluations 0 :type fixnum)           ; counted by the formula, and here where the first step is chosen
  (after-rejection nil)
  (trouble nil)                          ; why a step failed: a condition, or :not-finite
  (times nil :type double-array)         ; where the accepted steps begin; with room for more
  (steps '())
  (most-kept 0 :type fixnum)             ; of how many steps something is kept; of later ones, checkpoints
  (checkpoints '())
  (observer nil)
  (max-steps 0 :type fixnum)
  (progress nil)
  (progress-time 0))

(defmacro with-control ((run) &body body)
  "BODY where (control QUANTITY) is a number that changes from step to step. They are kept in an array, unboxed."
  `(with-fast-arithmetic
     (let ((control (run-control ,run)))
       (declare (type (simple-array double-float (*)) control))
       (macrolet ((control (quantity)
                    `(aref control
                           ,(position quantity
                                      '(time step end direction relative longest error previous-error start
                                        exponent)))))
         ,@body))))

(defmacro with-run ((run) &body body)
  "BODY with what a step needs as variables: field, in, n, state, next, now and h, and as WITH-CONTROL."
  `(with-control (,run)
     (let ((field (run-field ,run)) (in (run-in ,run)) (n (run-n ,run))
           (state (run-state ,run)) (next (run-next ,run)) (now (control time)) (h (control step)))
       (declare (type (simple-array double-float (*)) in state next) (fixnum n) (double-float h now)
                (type function field) (ignorable field in n state next h now))
       ,@body)))
