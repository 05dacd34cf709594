;;; anmech: what methods of integration share: problems, steps and their control, dense output.
;;;
;;; A *problem* is a field with a first state and a last time.  What comes of it is an *integration*: the times and
;;; states where steps begin.  Of a step within which somebody wants to know the state, there is besides something that
;;; only the method understands; its function INTERPOLANT gives the state at any time within the step from that.  So
;;; whoever reads an integration knows no method: DENSE-VALUE gives the state at a time, STATE-OF-STEP that at the
;;; beginning of a step.
;;;
;;; A method with an estimate of the error of a step is a *formula*; then all else is done here, by INTEGRATE-BY-STEPS:
;;; the first step, the choice of the others, what happens where the field leaves its domain, the end.  The functions of
;;; a formula take a *run*, which holds what they need: see the structures FORMULA and RUN, and the macro WITH-RUN.
;;; A method that does not go step by step like this makes an integration itself, by MAKE-INTEGRATION.
;;;
;;; Entry points: the structures PROBLEM, TOLERANCE, FORMULA, RUN, INTEGRATION; INTEGRATE-BY-STEPS; WITH-RUN;
;;; DENSE-VALUE, STATE-OF-STEP, STEP-LENGTH, INTEGRATION-START, INTEGRATION-TIME; ZEROS.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4
;;; (initial step, step control); volume II, 2nd ed. 1996, IV.2 (PI control, recognition of stiffness).

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/projection")

;;; Problems

(defstruct problem
  model                             ; for methods that need more than the field: its program, to be differentiated
  field                             ; function (in out) of double arrays
  (start nil :type double-array)    ; states, time, parameters
  (n 0 :type fixnum)                ; the number of states
  end                               ; the last time
  timed                             ; whether the field depends on time
  most-steps                        ; so many are worth taking; nil: as many as the user allows
  (patience nil)                    ; how many steps are worth taking where only stability bounds them; nil: all
  (stiffness nil)                   ; of an integration that was given up because of it; see INTEGRATION
  (projection nil)                  ; what the steps are to end on (projection.lisp); nil: where they end
  (noise nil))                      ; factors, one for each state, by which the field sees them changed; nil: none

(defun problem-time (problem) (aref (problem-start problem) (problem-n problem)))

(defstruct tolerance
  "The error that one step may have: of each state, the absolute one and RELATIVE times its size.  OBSERVER is to be
called after every step with the array of its end, like the input of the field: it may let the absolute ones grow."
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
  final            ; the state at the time reached
  largest          ; the largest size of each state where steps begin and end; nil if nobody has looked
  accepted rejected evaluations
  stiffness        ; where only stability bounds the steps: a pair of the time when that was seen, and the rate of decay
  status           ; :ok, :stopped, :interrupted, :too-many-steps, :stiff, :step-too-small, :too-large, :domain or
                   ; :not-finite
  message)         ; what happened, a sentence; nil if all is well

(defparameter *replayed* 64 "How many steps are taken again at once where they were not kept.")

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
        (floor (length (the double-array states)) (length (the double-array (integration-final integration))))
        0)))

(defun kept-of-step (integration place)
  "What the method keeps of the step at PLACE, which may have to be taken again."
  (let ((steps (integration-steps integration)))
    (declare (simple-vector steps) (fixnum place))
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
    (flet ((copy (states offset)
             (declare (type double-array states) (fixnum offset))
             (replace out states :start2 offset :end2 (the fixnum (+ offset n)))))
      (cond ((= place (step-count integration)) (copy (integration-final integration) 0))
            ((minusp later) (copy (integration-states integration) (* place n)))
            ((and (integration-states integration) (zerop (mod later *replayed*)))
             (copy (svref (integration-checkpoints integration) (floor later *replayed*)) 0))
            (t (funcall (the function (integration-interpolant integration)) (kept-of-step integration place)
                        (aref (the double-array (integration-times integration)) place) out n)))))
  out)

;;; Formulas and runs

(defstruct formula
  "How a method takes one step.  The first four functions take a run.
BEGIN    before all, and where steps are to be taken again: makes WORK, unless it is there, computes the rates at the
         beginning and returns them; or sets the first step itself, (control step), and returns nil
ATTEMPT  the state at the end of a step of the length (control step) goes to NEXT, the estimate of its error, in units
         of the tolerance, to (control error): up to 1, the step is good; above 1e200, nothing came of it.  The step may
         be made shorter here.  Conditions of the field pass through
COMPLETE after an attempt that was good, and whose end, NEXT, may since have been moved a little, onto what is constant:
         what is to be kept of the step.  The next attempt begins at its end
SKETCH   the same where nothing is to be kept; nil: as COMPLETE
CHOOSE   sets the length of the next step after that
DECAY    after a step that was completed, before the next one begins: the rate of the fastest decay, as the two last
         states that the field has seen show it; 0 if they show none; nil: the method cannot know.  Steps that this
         rate makes longer than STABLE are bounded by stability, not by the error
VALUE    function (kept time out n): the state at a time within the step goes to OUT; where it begins, that exactly
ROOM     function (n): how many doubles are kept of a step
The same step, taken twice, gives the same: most are never asked for, so all are sketched, and taken again if they are"
  (order 8 :type fixnum)         ; the error is of this power of the step
  begin attempt complete sketch (choose 'choose-step) decay (stable 1d0 :type double-float) value room)

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
  (projector nil)                        ; see INTEGRATION
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

(defconstant +damping+ 0.04d0 "How much the error of the step before counts (the PI controller's beta).")

(defun new-run (formula problem tolerance max-steps progress)
  (let* ((n (problem-n problem))
         (t0 (problem-time problem))
         (t1 (problem-end problem))
         (run (make-run :formula formula :field (problem-field problem) :in (copy-seq (problem-start problem)) :n n
                        :state (zeros n) :next (zeros n) :largest (zeros n) :control (zeros 10)
                        :absolute (tolerance-absolute tolerance) :problem problem :times (zeros 64)
                        :states (zeros (* 64 n)) :stiffness (problem-stiffness problem) :stiff-since t0
                        :max-steps max-steps :observer (tolerance-observer tolerance)
                        :most-kept (floor *most-doubles* n)
                        :progress progress :progress-time (get-internal-real-time))))
    (replace (run-state run) (problem-start problem) :end2 n)
    (map-into (run-largest run) #'abs (run-state run))
    (when (problem-projection problem)
      (setf (run-projector run) (make-projector (problem-projection problem) (problem-start problem) n
                                                (copy-seq (tolerance-absolute tolerance))
                                                (tolerance-relative tolerance))))
    (with-control (run)
      (setf (control time) t0
            (control start) t0
            (control end) t1
            (control direction) (if (< t1 t0) -1d0 1d0)
            (control relative) (tolerance-relative tolerance)
            (control longest) (abs (- t1 t0))
            (control previous-error) 1d-4
            (control exponent) (- (/ 1d0 (formula-order formula)) (* 0.2d0 +damping+))))
    run))

(defun zeros (size) (make-array size :element-type 'double-float :initial-element 0d0))

(defparameter *most-doubles* 2000000
  "How many are kept of the states of an integration, and of what a method keeps of steps: 16 megabytes each.")

(defun integrate-by-steps (formula problem tolerance max-steps progress)
  "Integrate PROBLEM by FORMULA.  PROGRESS is nil, or called now and then with the part of the way that is done."
  (let* ((run (new-run formula problem tolerance max-steps progress))
         (status (run-to-end run))
         (times (times-of run)) (n (run-n run)) (kept (min (run-accepted run) (run-most-kept run))))
    (make-integration :times times
                      :states (subseq (run-states run) 0 (* n kept))
                      :steps (make-array (min kept (floor *most-doubles* (funcall (formula-room formula) n)))
                                         :initial-element nil)
                      :interpolant (value-within-step (formula-value formula))
                      :checkpoints (coerce (nreverse (run-checkpoints run)) 'simple-vector)
                      :replay (taking-again run times)
                      :projector (run-projector run)
                      :final (copy-seq (run-state run))
                      :largest (run-largest run)
                      :accepted (run-accepted run)
                      :rejected (run-rejected run)
                      :evaluations (run-evaluations run)
                      :stiffness (run-stiffness run)
                      :status status
                      :message (status-message status run))))

(defun taking-again (run times)
  "The function REPLAY of what comes of RUN."
  (let ((again nil))
    (lambda (states offset from to)
      (unless again (setq again (run-again run)))
      (steps-again again times states offset from to))))

(defun run-again (run)
  "A run of the same steps, as far as its steps are told it."
  (let ((again (new-run (run-formula run) (run-problem run)
                        (make-tolerance :relative 0d0 :absolute (run-absolute run)) 0 nil)))
    (setf (run-projector again) (run-projector run))
    again))

(defun steps-again (run times states offset from to)
  "What is kept of the steps at the places FROM to TO, not included; where the first begins, STATES holds the state from
OFFSET on."
  (declare (type double-array times states))
  (place-run run states offset (aref times from))
  (funcall (formula-begin (run-formula run)) run)
  (let ((kept (make-array (- to from))))
    (loop for place from from below to
          do (let ((time (aref times place)) (next (aref times (1+ place))))
               (attempt-until run next)
               (project-end run)
               (setf (svref kept (- place from))
                     (handler-case (funcall (formula-complete (run-formula run)) run)
                       ((or domain-violation arithmetic-error) () (state-by-steps run time))))
               (move-on run)
               (place-time run next)))
    kept))

(defun attempt-until (run time)
  "Attempt a step that ends at TIME."
  (with-control (run)
    (setf (control step) (flo (- (the double-float time) (control time)))))
  (funcall (formula-attempt (run-formula run)) run))

(defun state-by-steps (run start)
  "What stands for what cannot be kept of the step of RUN from START on, since that takes values of the field where it
has none: a function (time out) that goes to TIME by steps of its own, halved where they meet with such places."
  (let* ((states (copy-seq (run-state run)))
         (again (run-again run)) (formula (run-formula run))
         (sketch (or (formula-sketch formula) (formula-complete formula))))
    (funcall sketch run)
    (lambda (time out)
      (place-run again states 0 start)
      (funcall (formula-begin formula) again)
      (loop with end = time
            for now = (with-control (again) (control time))
            until (= now time)
            do (handler-case (progn (attempt-until again end)
                                    (project-end again)
                                    (funcall sketch again)
                                    (move-on again)
                                    (place-time again end)
                                    (setq end time))
                 ((or domain-violation arithmetic-error) (condition)
                   (let ((middle (* 0.5d0 (+ now end))))
                     (when (or (= middle now) (= middle end)) (error condition))
                     (setq end middle)))))
      (replace out (run-state again)))))

(defun value-within-step (value)
  "VALUE of a formula, where a function may stand for what is kept."
  (declare (type function value))
  (lambda (kept time out n)
    (if (functionp kept) (funcall kept time out) (funcall value kept time out n))))

(defun place-run (run states offset time)
  "Let RUN begin at TIME and the state that stands in STATES from OFFSET on."
  (declare (type double-array states) (fixnum offset))
  (let ((n (run-n run)))
    (replace (run-state run) states :end1 n :start2 offset)
    (replace (run-in run) states :end1 n :start2 offset)
    (place-time run time)))

(defun place-time (run time)
  (with-control (run)
    (setf (control time) time
          (aref (run-in run) (run-n run)) time)))

(defun times-of (run)
  (let ((times (subseq (run-times run) 0 (1+ (run-accepted run)))))
    (setf (aref times (run-accepted run)) (with-control (run) (control time)))
    times))

(defun run-to-end (run)
  "Advance; a step in which the field leaves its domain or overflows is tried again with a shorter one. The status."
  (flet ((tried (function)
           (handler-case (funcall function run)
             (domain-violation (condition) (setf (run-trouble run) condition) nil)
             (arithmetic-error () (setf (run-trouble run) :not-finite) nil))))
    (with-control (run)
      (cond ((= (control time) (control end)) :ok)
            ((too-large-p run) :too-large)
            (t (let ((status (and (tried #'begin) (tried #'advance))))
                 (loop until (or status (zerop (control step)))
                       do (shorten-step run 0.25d0)
                          (setq status (tried #'advance)))
                 (cond ((not (member status '(nil :step-too-small))) status)
                       ((null (run-trouble run)) :step-too-small)
                       ((eq :not-finite (run-trouble run)) :not-finite)
                       (t :domain))))))))

(defun status-message (status run)
  (let ((time (if (eq status :ok) "" (maxima-text (with-control (run) (control time))))))
    (ecase status
      ((:ok :stopped) nil)
      (:interrupted (format nil "interrupted at time ~a" time))
      (:too-many-steps (format nil "~d steps were not enough: the motion was followed to time ~a"
                               (run-max-steps run) time))
      (:stiff (format nil "the equations are stiff: the motion was followed to time ~a" time))
      (:step-too-small (format nil "the step became too small at time ~a: the motion has a singularity there, or no ~
                                    double is as accurate as it was asked to be" time))
      (:not-finite (format nil "the rates grow without bound at time ~a" time))
      (:too-large (format nil "the motion ends at time ~a: states beyond ~a are too large for doubles; state them in ~
                               other units"
                          time (maxima-text +largest-size+)))
      (:domain (format nil "the motion ends at time ~a: ~a" time (run-trouble run))))))

;;; Step after step

(defun advance (run)
  "Take steps until the end, or something else that ends the run: the status. Conditions of the field pass through."
  (declare (type run run))
  (let* ((formula (run-formula run))
         (attempt (coerce (formula-attempt formula) 'function))
         (sketch (coerce (or (formula-sketch formula) (formula-complete formula)) 'function))
         (choose (coerce (formula-choose formula) 'function)))
    (declare (type function attempt sketch choose))
    (with-control (run)
      (loop
        (let ((left (flo (- (control end) (control time)))))
          (declare (double-float left))
          (cond ((= left 0d0) (return :ok))
                ((interrupted-p) (return :interrupted))
                ((>= (the fixnum (steps-tried run)) (run-max-steps run))
                 (return :too-many-steps))
                ((<= (flo (abs left)) (flo (* 1.01d0 (abs (control step)))))
                 (setf (control step) left))
                ((step-negligible-p run) (return :step-too-small))
                ;; a step that the time can be moved by exactly: else time and state would part by roundings
                (t (setf (control step) (flo (- (+ (control time) (control step)) (control time))))))
          (funcall attempt run)
          (cond ((<= (control error) 1d0)
                 (project-end run)
                 (funcall sketch run)
                 (watch-stability run)
                 (accept-step run)
                 (when (= (control step) left)
                   (setf (control time) (control end)))
                 (when (too-large-p run) (return :too-large))
                 (when (impatient-p run) (return :stiff))
                 (funcall choose run)
                 (let ((observer (run-observer run)))
                   (when (and observer (eq :stop (funcall (the function observer) (run-in run))))
                     (return :stopped))))
                (t (reject-step run)))
          (when (run-progress run) (report-progress run)))))))

;; Where a decay that has long died out is so fast that only stability bounds the steps, their number grows with the
;; rate of the decay, however smooth the motion is.
(defparameter *steps-between-looks* 40 "How often stability is looked at while it is not known to bound the steps.")
(defparameter *stiff-steps* 15 "So many bounded by stability, without *MILD-STEPS* others among them, are no chance.")
(defparameter *mild-steps* 6)

(defun watch-stability (run)
  "Count the steps that stability bounds, and note when they are so many that it is no chance."
  (declare (type run run))
  (let ((decay (formula-decay (run-formula run))))
    (when (and decay
               (or (plusp (run-stiff run))
                   (zerop (the fixnum (rem (run-accepted run) (the fixnum *steps-between-looks*))))))
      (let ((rate (funcall (the function decay) run)))
        (declare (double-float rate))
        (with-control (run)
          (cond ((> (flo (* rate (abs (control step)))) (formula-stable (run-formula run)))
                 (when (zerop (run-stiff run))
                   (setf (run-stiff-since run) (control time)
                         (run-stiff-count run) (steps-tried run)))
                 (setf (run-mild run) 0)
                 (when (and (= (incf (run-stiff run)) (the fixnum *stiff-steps*)) (null (run-stiffness run)))
                   (setf (run-stiffness run) (cons (control time) rate))))
                ((= (incf (run-mild run)) (the fixnum *mild-steps*))
                 (setf (run-stiff run) 0 (run-mild run) 0))))))))

(defparameter *patient-steps* 400 "So many steps are seen before it is judged how many there will be.")

(defun impatient-p (run)
  "Whether stability bounds the steps, or those of a rougher integration, and they are going to be too many."
  (declare (type run run))
  (and (or (> (run-stiff run) (the fixnum *stiff-steps*)) (problem-stiffness (run-problem run)))
       (zerop (the fixnum (rem (run-accepted run) (the fixnum *patient-steps*))))
       (problem-patience (run-problem run))
       (> (stiff-steps-needed run) (min (run-max-steps run) (problem-patience (run-problem run))))))

(defun stiff-steps-needed (run)
  "How many steps the way would take in all, if those to come are as long as those that stability has bounded."
  (with-control (run)
    (let ((count (steps-tried run)))
      (+ count (ceiling (* (- count (run-stiff-count run))
                           (/ (- (control end) (control time)) (- (control time) (run-stiff-since run)))))))))

(defun steps-tried (run)
  (declare (type run run))
  (the fixnum (+ (the fixnum (run-accepted run)) (the fixnum (run-rejected run)))))

(defparameter *most-short-steps* 500
  "How many steps without a break may be shorter than 1e-9 of the way so far: at a singularity there is no end.")

(defun step-negligible-p (run)
  (declare (type run run))
  (with-control (run)
    (let ((size (flo (abs (control step)))) (way (flo (abs (- (control time) (control start))))))
      (declare (double-float size way))
      (if (<= size (flo (* 1d-9 way)))
          (incf (run-short run))
          (setf (run-short run) 0))
      (or (<= size (flo (* 2.3d-15 (abs (control time)))))
          (< size 1d-300)
          (> (run-short run) (the fixnum *most-short-steps*))))))

(defun too-large-p (run)
  (with-control (run)
    (let ((largest (run-largest run)) (all 0d0))
      (declare (type (simple-array double-float (*)) largest) (double-float all))
      (for (i (length largest)) (setq all (flo (max all (aref largest i)))))
      (> all +largest-size+))))

(defun project-end (run)
  "Move the end of the step onto what is constant, if that is wanted and such states are near."
  (declare (type run run))
  (let ((projector (run-projector run)))
    (when projector
      (with-run (run) (funcall (the function projector) next (flo (+ now h)))))))

(defun accept-step (run)
  "The end of the step becomes the beginning of the next one."
  (declare (type run run))
  (note-time run)
  (if (< (the fixnum (run-accepted run)) (the fixnum (run-most-kept run)))
      (note-state run)
      (note-checkpoint run))
  (incf (run-accepted run))
  (setf (run-trouble run) nil)
  (move-on run))

(defun note-state (run)
  "Keep the state at the beginning of the step that is being accepted."
  (declare (type run run))
  (let* ((n (run-n run)) (count (run-accepted run)) (place (fix (* n count))))
    (declare (fixnum n count place))
    (when (> (fix (+ place n)) (length (run-states run)))
      (setf (run-states run) (replace (zeros (* 2 (length (run-states run)))) (run-states run))))
    (let ((states (run-states run)) (state (run-state run)))
      (declare (type (simple-array double-float (*)) states state))
      (with-fast-arithmetic
        (for (i n) (setf (aref states (fix (+ place i))) (aref state i)))
        nil))))

(defun note-checkpoint (run)
  (when (zerop (mod (- (run-accepted run) (run-most-kept run)) *replayed*))
    (push (copy-seq (run-state run)) (run-checkpoints run))))

(defun move-on (run)
  "State and time at the end of the step."
  (declare (type run run))
  (rotatef (run-state run) (run-next run))
  (with-run (run)
    (let ((largest (run-largest run)))
      (declare (type (simple-array double-float (*)) largest))
      (for (i n)
        (setf (aref in i) (aref state i)
              (aref largest i) (flo (max (aref largest i) (abs (aref state i))))))
      (setf (control time) (flo (+ now h))
            (aref in n) (control time))
      nil)))

(defun note-time (run)
  "Keep the time at which the step that is being accepted begins."
  (declare (type run run))
  (let ((count (run-accepted run)))
    (when (>= (fix (+ count 1)) (length (run-times run)))
      (setf (run-times run) (replace (zeros (* 2 (length (run-times run)))) (run-times run))))
    (with-control (run)
      (let ((times (run-times run)))
        (declare (type (simple-array double-float (*)) times))
        (setf (aref times count) (control time))
        nil))))

(defmacro raised (base exponent)
  `(the double-float (#+gcl c-expt #-gcl expt (the (double-float 0d0) ,base) ,exponent)))

(defun choose-step (run)
  "The next step after one that was accepted."
  (with-control (run)
    (let* ((error (flo (max (control error) 1d-4)))
           (growth (flo (/ (* 0.9d0 (raised (control previous-error) +damping+)) (raised error (control exponent)))))
           (limit (if (run-after-rejection run) 1d0 6d0))
           (size (flo (min (* (abs (control step)) (min limit (max growth 0.333d0))) (control longest)))))
      (declare (double-float error growth limit size))
      (setf (control previous-error) error
            (control step) (flo (* size (control direction)))
            (run-after-rejection run) nil))))

(defun reject-step (run)
  (with-control (run)
    (let ((error (control error)))
      (declare (double-float error))
      (cond ((< error 1d200)
             (shorten-step run (flo (max 0.333d0 (/ 0.9d0 (raised error (control exponent)))))))
            (t (setf (run-trouble run) :not-finite)
               (shorten-step run 0.25d0))))))

(defun shorten-step (run factor)
  (with-control (run)
    (setf (control step) (* (control step) factor)
          (run-after-rejection run) t)
    (incf (run-rejected run))))

(defun report-progress (run)
  "Tell how far the run is, twice a second at most."
  (when (zerop (logand 63 (+ (run-accepted run) (run-rejected run))))
    (let ((clock (get-internal-real-time)))
      (when (> (- clock (run-progress-time run)) (/ internal-time-units-per-second 2))
        (setf (run-progress-time run) clock)
        (with-control (run)
          (funcall (run-progress run)
                   (/ (- (control time) (control start)) (- (control end) (control start)))))))))

;;; The first step

(defun begin (run)
  "The first rates and the first step."
  (let ((rates (funcall (formula-begin (run-formula run)) run)))
    (when rates
      (unless (every (lambda (rate) (<= (abs rate) most-positive-double-float)) rates)
        (error 'arithmetic-error))
      (guess-step run rates))
    t))

(defun weighted-norm (run array)
  "The root mean square of ARRAY in units of the tolerance at the beginning of the step."
  (declare (type (simple-array double-float (*)) array))
  (with-run (run)
    (let ((sum 0d0) (absolute (run-absolute run)) (relative (control relative)))
      (declare (double-float sum relative) (type (simple-array double-float (*)) absolute))
      (for (i n)
        (let ((ratio (flo (min 1d100
                               (/ (abs (aref array i))
                                  (max (+ (aref absolute i) (* relative (abs (aref state i)))) +least-unit+))))))
          (declare (double-float ratio))
          (setq sum (flo (+ sum (* ratio ratio))))))
      (flo (sqrt (/ sum (+ 0d0 n)))))))

(defun guess-step (run rates)
  "A first step from the size of the state, of its rates and of their change over a trial step of Euler's method."
  (with-control (run)
    (let* ((size (weighted-norm run (run-state run)))
           (slope (weighted-norm run rates))
           (trial (min (if (or (< size 1d-10) (< slope 1d-10)) 1d-6 (* 0.01d0 (/ size slope)))
                       (control longest)))
           (root (/ 1d0 (formula-order (run-formula run)))))
      (declare (double-float root))
      (setf (control step) (* trial (control direction)))
      (let* ((change (handler-case (change-of-rates run rates) ((or domain-violation arithmetic-error) () 0d0)))
             (largest (max slope (/ change trial)))
             (order-guess (cond ((not (< largest 1d200)) trial)         ; also if it is not finite
                                ((<= largest 1d-15) (max 1d-6 (* trial 1d-3)))
                                (t (raised (/ 0.01d0 largest) root)))))
        (setf (control step)
              (* (control direction)
                 (if (problem-noise (run-problem run)) 0.6d0 1d0)     ; so that other steps begin elsewhere
                 (min (control longest)
                      (max (min (* 100 trial) order-guess)
                           (* 1d-14 (abs (control time)))))))))))          ; what is seen of so late a time

(defun change-of-rates (run rates)
  "The weighted norm of what a step of Euler's method changes of RATES."
  (declare (type (simple-array double-float (*)) rates))
  (incf (run-evaluations run))
  (let ((change (zeros (run-n run))))
    (declare (type (simple-array double-float (*)) change))
    (with-run (run)
      (for (i n) (setf (aref in i) (flo (+ (aref state i) (* h (aref rates i))))))
      (setf (aref in n) (flo (+ now h)))
      (funcall field in change)
      (for (i n) (setf (aref change i) (flo (- (aref change i) (aref rates i))))))
    (weighted-norm run change)))
