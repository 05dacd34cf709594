;;; anmech: what methods of integration share: problems, steps and their control, dense output.
;;;
;;; A *problem* is a field with a first state and a last time.  What comes of it is an *integration*: the times and
;;; states where steps begin.  Of a step within which somebody wants to know the state, there is besides something that
;;; only the method understands; its function INTERPOLANT gives the state at any time within the step from that.  So
;;; whoever reads an integration knows no method: DENSE-VALUE gives the state at a time, STATE-OF-STEP that at the
;;; beginning of a step.
;;;
;;; A method with an estimate of the error of a step is a *formula*; then all else is done for it, by INTEGRATE-BY-STEPS
;;; (steps.lisp): the first step, the choice of the others, kinks, events, what happens where the field leaves its
;;; domain, the end.  The functions of a formula take a *run*, which holds what they need: see the structures FORMULA
;;; and RUN, and the macro WITH-RUN.  A method that does not go step by step like this makes an integration itself, by
;;; MAKE-INTEGRATION.
;;;
;;; Entry points: the structures PROBLEM, EVENT, TOLERANCE, FORMULA, RUN, INTEGRATION; WITH-RUN, WITH-CONTROL;
;;; DENSE-VALUE, VALUE-IN-STEP, STATE-OF-STEP, STATES-KEPT, KEPT-OF-STEP, STEP-COUNT, STEP-PLACE, STEP-PLACE-FROM,
;;; STEP-LENGTH, INTEGRATION-START, INTEGRATION-TIME; *REPLAYED*.

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
  most-steps                        ; so many are worth taking; nil: as many as the user allows
  (patience nil)                    ; how many steps are worth taking where only stability bounds them; nil: all
  (stiffness nil)                   ; of an integration that was given up because of it; see INTEGRATION
  (projection nil)                  ; what the steps are to end on (projection.lisp); nil: where they end
  (events '())                      ; see below
  (breakpoints '())                 ; times, in the order of the motion, at which steps end
  longest                           ; the longest step; nil: any
  (frugal nil)                      ; whether nothing but the end will be asked for: other states are not kept
  (whole 0 :type fixnum)            ; of how many first steps what the method keeps is computed at once
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
called after every step with the array of its end, like the input of the field: it may let the absolute ones grow, and
end the integration by giving :crawling."
  relative
  (absolute nil :type double-array)
  observer)

;;; What comes of it

(defstruct integration
  times            ; double array: where the steps begin, and the time reached
  (states nil)     ; double array: the states where they begin, one after the other; of the first ones, if they are very
                   ; many; nil: the method tells them from what it keeps
  steps            ; simple vector: what the method keeps of each step; nil of one that will be taken again if somebody
                   ; wants to know, as will be those that there is no place for
  interpolant      ; function (step time out n): the state at a time within the step
  (checkpoints #() :type simple-vector)   ; the states where every *REPLAYED*th of the steps without a state begins
  replay           ; function (states offset from to): what the method keeps of these steps, taken again; of the states
                   ; where the first begins, the first number is at OFFSET
  (replayed nil)   ; the first place of the steps without a place that were taken again last, and the vector of them
  projector        ; of what the steps were projected onto, for the states within them; or nil
  sides            ; function (point): the sides of surfaces at the time and state in it are noted there; nil: nobody
                   ; knows
  (grazes '())     ; where it has come next to a surface (grazing.lisp)
  (beginnings #()) ; the places of steps before which the field has changed, or was to begin anew
  ended-by         ; the event that has ended it, if one has
  final            ; the state at the time reached
  largest          ; the largest size of each state where steps begin and end; nil if nobody has looked
  accepted rejected evaluations
  (implicit nil)   ; whether its formula is: then states within steps are of a much lower order than their ends
  (even nil)       ; whether states within steps are as good as their ends
  stiffness        ; where only stability bounds the steps: a pair of the time when that was seen, and the rate of decay
  status           ; :ok, :stopped, :event, :interrupted, :too-many-steps, :stiff, :step-too-small, :too-large, :domain,
                   ; :not-finite, :undetermined or :crawling
  message)         ; what happened, a sentence; nil if all is well

(defparameter *replayed* 64 "How many steps are taken again at once where they were not kept.")

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (t double-float) t) step-place)
         (ftype (function (t fixnum double-float) t) step-place-from)
         (ftype (function (t fixnum) t) kept-of-step)
         (ftype (function (t fixnum t) t) state-of-step)
         (ftype (function (t fixnum double-float t) t) value-in-step))

(defun integration-start (integration) (aref (the double-array (integration-times integration)) 0))

(defun integration-time (integration)
  "The time reached."
  (let ((times (integration-times integration)))
    (declare (type (simple-array double-float (*)) times))
    (with-fast-arithmetic (aref times (fix (- (length times) 1))))))

(defun step-length (integration place)
  (declare (fixnum place))
  (let ((times (integration-times integration)))
    (declare (type (simple-array double-float (*)) times))
    (with-fast-arithmetic (flo (- (aref times (fix (+ place 1))) (aref times place))))))

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

(defun step-place-from (times place time)
  "The same, not before PLACE, and near there."
  (declare (type (simple-array double-float (*)) times) (double-float time) (fixnum place))
  (with-fast-arithmetic
    (let* ((count (length times)) (last (fix (- count 2))) (forward (<= (aref times 0) (aref times (fix (- count 1))))))
      (declare (fixnum count last))
      (loop
        (let ((next (fix (+ place 1))))
          (declare (fixnum next))
          (when (or (>= place last)
                    (let ((there (aref times next)))
                      (declare (double-float there))
                      (if forward (> there time) (< there time))))
            (return place))
          (setq place next))))))

(defun states-kept (integration)
  "Of how many steps it has the state where they begin."
  (let ((states (integration-states integration)))
    (if states
        (let ((numbers (length (the double-array states)))
              (n (length (the double-array (integration-final integration)))))
          (declare (fixnum numbers n))
          (values (the fixnum (truncate numbers n))))
        0)))

(defun kept-of-step (integration place)
  "What the method keeps of the step at PLACE, which may have to be taken again."
  (declare (fixnum place))
  (let ((steps (integration-steps integration)))
    (declare (simple-vector steps))
    (if (< place (length steps))
        (or (svref steps place)
            (setf (svref steps place) (svref (taken-again integration place (1+ place)) 0)))
        (multiple-value-bind (first end) (block-of-steps integration place)
          (unless (eql first (car (integration-replayed integration)))
            (setf (integration-replayed integration) (cons first (taken-again integration first end))))
          (svref (cdr (integration-replayed integration)) (- place first))))))

(defun block-of-steps (integration place)
  "The places of the first of the steps that are taken again together with the one at PLACE, and behind the last."
  (let* ((kept (states-kept integration)) (first (- place (mod (- place kept) *replayed*))))
    (if (< place kept)
        (values place (1+ place))
        (values first (min (+ first *replayed*) (step-count integration))))))

(defun taken-again (integration first end)
  (let ((replay (integration-replay integration)) (kept (states-kept integration)))
    (declare (type function replay))
    (if (< first kept)
        (funcall replay (integration-states integration) (* first (length (integration-final integration))) first end)
        (funcall replay (svref (integration-checkpoints integration) (floor (- first kept) *replayed*)) 0 first end))))

(defun step-count (integration) (1- (length (the double-array (integration-times integration)))))

(defun dense-value (integration time out)
  "Write the state at TIME, which is between the ends, to OUT."
  (let ((final (integration-final integration)) (time (float time 1d0)))
    (declare (type (simple-array double-float (*)) final))
    (if (= time (integration-time integration))
        (replace out final)
        (value-in-step integration (step-place (integration-times integration) time) time out))
    out))

(defun value-in-step (integration place time out)
  "Write the state at TIME, which is within the step at PLACE, to OUT."
  (funcall (the function (integration-interpolant integration)) (kept-of-step integration place) time out
           (length (the double-array (integration-final integration))))
  (when (integration-projector integration)
    (handler-case (funcall (the function (integration-projector integration)) out time)
      ((or domain-violation arithmetic-error) () nil))))

(defun state-of-step (integration place out)
  "Write the state where the step at PLACE begins to OUT; after the last, that at the end."
  (declare (fixnum place) (type double-array out))
  (let* ((n (length (the double-array (integration-final integration)))) (later (- place (states-kept integration))))
    (flet ((copy (states offset) (copy-part n states offset out)))
      (cond ((= place (step-count integration)) (copy (integration-final integration) 0))
            ((minusp later) (copy (integration-states integration) (* place n)))
            ((and (integration-states integration) (zerop (mod later *replayed*)))
             (copy (svref (integration-checkpoints integration) (floor later *replayed*)) 0))
            (t (funcall (the function (integration-interpolant integration)) (kept-of-step integration place)
                        (aref (the double-array (integration-times integration)) place) out n)))))
  out)

;;; Formulas and runs

(defstruct formula
  "How a method takes one step.  The first functions take a run.
BEGIN    before all, wherever the field changes, and where steps are to be taken again: makes WORK, unless it is there,
         computes the rates at the beginning and returns them; or sets the first step itself, (control step), and
         returns nil
ATTEMPT  the state at the end of a step of the length (control step) goes to NEXT, the estimate of its error, in units
         of the tolerance, to (control error): up to 1, the step is good; above 1e200, nothing came of it.  The step may
         be made shorter here.  Conditions of the field pass through
COMPLETE after an attempt that was good, and whose end, NEXT, may since have been moved a little, onto what is constant:
         what is to be kept of the step.  The next attempt begins at its end
SAFE     a function (run): whether COMPLETE meets with no conditions of the field; nil: it may
SKETCH   the same where nothing is to be kept; nil: as COMPLETE
CHOOSE   sets the length of the next step after that; nil: by what is usual (steps.lisp)
DECAY    after a step that was completed, before the next one begins: the rate of the fastest decay, as the two last
         states that the field has seen show it; 0 if they show none; nil: the method cannot know.  Steps that this
         rate makes longer than STABLE are bounded by stability, not by the error
VALUE    function (kept time out n): the state at a time within the step goes to OUT; where it begins, that exactly
ROOM     function (n): how many doubles are kept of a step
WHOLE    of so many first steps, where a problem wants some, what is kept costs nothing: more of it is kept at once
IMPLICIT whether it can step over a fast decay, and be right where the step ends
EVEN     function (): whether states within all steps that were taken are as good as their ends; nil: they are not
The same step, taken twice, gives the same: most are never asked for, so all but the first ones are sketched, and taken
again if they are"
  (order 8 :type fixnum)         ; the error is of this power of the step
  begin attempt complete safe sketch choose decay (stable 1d0 :type double-float) value room (whole 0 :type fixnum)
  implicit even)

(defstruct run
  (formula nil :type formula)
  (attempt nil :type function)           ; of the formula, as the next three, or what stands for them: to find the
  (complete nil :type function)          ; function of a name at every step takes as long as ten operations
  (safe nil)
  (sketch nil :type function)
  (choose nil :type function)
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
  (projector nil)                        ; see INTEGRATION
  watcher                                ; of kinks and events (switching.lisp), or nil
  (stops '())                            ; the breakpoints to come
  (beginnings '())                       ; the places of steps before which the field has changed, the last first; when
                                         ; the run has ended, a vector of them in order
  (stale nil)                            ; whether the formula must begin again
  (accepted 0 :type fixnum)
  (rejected 0 :type fixnum)
  (short 0 :type fixnum)                 ; how many steps without a break were very short
  (evaluations 0 :type fixnum)           ; counted by the formula, and here where the first step is chosen
  (after-rejection nil)
  (stiff 0 :type fixnum)                 ; how many of the last steps were bounded by stability
  (mild 0 :type fixnum)                  ; how many without a break were not
  (stiffness nil)                        ; see INTEGRATION
  (stiff-since 0d0)                      ; when the first of those began
  (stiff-count 0 :type fixnum)           ; and how many steps there were before it
  (trouble nil)                          ; why a step failed: a condition, or :not-finite
  (times nil :type double-array)         ; where the accepted steps begin; with room for more
  (states nil :type double-array)        ; and the states there, with room for more
  (most-kept 0 :type fixnum)             ; of how many steps they are kept; of later ones, checkpoints
  (checkpoints '())
  (most-whole 0 :type fixnum)            ; of how many of the first steps what the formula keeps is kept at once
  (steps #() :type simple-vector)        ; and that, with room for more
  (observer nil)
  (max-steps 0 :type fixnum)
  (progress nil)
  (progress-time 0))

(defmacro with-control ((run) &body body)
  "BODY where (control QUANTITY) is a number that changes from step to step. They are kept in an array, unboxed.
STOP is the time at which a step must end, LEFT the way to there; WANTED the step that would be taken without it."
  `(with-fast-arithmetic
     (let ((control (run-control ,run)))
       (declare (type (simple-array double-float (*)) control))
       (macrolet ((control (quantity)
                    `(aref control
                           ,(position quantity
                                      '(time step end direction relative longest error previous-error start
                                        exponent stop left wanted)))))
         ,@body))))

(defmacro with-run ((run) &body body)
  "BODY with what a step needs as variables: field, in, n, state, next, now and h, and as WITH-CONTROL."
  `(with-control (,run)
     (let ((field (run-field ,run)) (in (run-in ,run)) (n (run-n ,run))
           (state (run-state ,run)) (next (run-next ,run)) (now (control time)) (h (control step)))
       (declare (type (simple-array double-float (*)) in state next) (fixnum n) (double-float h now)
                (type function field) (ignorable field in n state next h now))
       ,@body)))
