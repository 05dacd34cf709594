;;; anmech: integration step by step, by any formula (integration.lisp).
;;;
;;; The first step, the choice of the others, what happens where the field leaves its domain, the end.  At *breakpoints*
;;; steps end, and the field is looked at anew.  Where the field has kinks, or events are looked for, each step that was
;;; good is searched for them (switching.lisp): then it is taken again so that it ends there, and what follows begins
;;; afresh.  So each *piece* between is as smooth as its equations, and so is what is kept of it.
;;;
;;; Entry points: INTEGRATE-BY-STEPS, CHOOSE-STEP, PLACE-STATE, RAISED, NATURAL-LOG, NATURAL-EXP.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4
;;; (initial step, step control); volume II, 2nd ed. 1996, IV.2 (PI control, recognition of stiffness); C. W. Gear,
;;; O. Osterby, Solving ordinary differential equations with discontinuities, ACM Trans. Math. Software 10 (1984) 23.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/doubles" "numerics/integration"
       "numerics/projection" "numerics/surfaces" "numerics/switching" "numerics/watching")

(defconstant +damping+ 0.04d0 "How much the error of the step before counts (the PI controller's beta).")

(defparameter *room* 64 "For so many steps there is room at first.")

(defun new-run (formula problem tolerance max-steps progress)
  (let* ((n (problem-n problem))
         (t0 (problem-time problem))
         (t1 (problem-end problem))
         (state (subseq (problem-start problem) 0 n))
         (watcher (new-watcher problem))
         (frugal (problem-frugal problem))
         (run (make-run :formula formula
                        :attempt (coerce (formula-attempt formula) 'function)
                        :complete (coerce (formula-complete formula) 'function)
                        :safe (formula-safe formula)
                        :sketch (coerce (or (formula-sketch formula) (formula-complete formula)) 'function)
                        :choose (coerce (or (formula-choose formula) 'choose-step) 'function)
                        :in (copy-seq (problem-start problem)) :n n
                        :state state :next (zeros n) :largest (map-doubles ((size state)) (abs size))
                        :control (zeros 13)
                        :absolute (tolerance-absolute tolerance) :problem problem :times (zeros *room*)
                        :states (zeros (if frugal 0 (* *room* n)))
                        :stiffness (problem-stiffness problem) :stiff-since t0
                        :max-steps max-steps :observer (tolerance-observer tolerance)
                        :watcher watcher :stops (problem-breakpoints problem)
                        :most-kept (if frugal 0 (floor *most-doubles* n))
                        :most-whole (steps-kept-at-once formula problem)
                        :progress progress :progress-time (if progress (get-internal-real-time) 0))))
    (setf (run-field run) (if watcher (watched-field watcher run) (problem-field problem)))
    (when (problem-projection problem)
      (setf (run-projector run) (make-projector (problem-projection problem) (problem-start problem) n
                                                (copy-seq (tolerance-absolute tolerance))
                                                (tolerance-relative tolerance))))
    (with-control (run)
      (setf (control time) t0
            (control start) t0
            (control end) t1
            (control stop) (or (first (problem-breakpoints problem)) t1)
            (control direction) (if (< t1 t0) -1d0 1d0)
            (control relative) (tolerance-relative tolerance)
            (control longest) (min (abs (- t1 t0)) (or (problem-longest problem) (abs (- t1 t0))))
            (control previous-error) 1d-4
            (control exponent) (- (/ 1d0 (formula-order formula)) (* 0.2d0 +damping+))))
    run))

(defun steps-kept-at-once (formula problem)
  "Of how many first steps what the formula keeps is computed when they are taken."
  (let ((wanted (problem-whole problem)))
    (if (zerop wanted)
        0
        (max wanted (min (formula-whole formula)
                         (floor *most-doubles* (funcall (formula-room formula) (problem-n problem))))))))

(defparameter *most-doubles* 2000000
  "How many are kept of the states of an integration, and of what a method keeps of steps: 16 megabytes each.")

(defun integrate-by-steps (formula problem tolerance max-steps progress)
  "Integrate PROBLEM by FORMULA.  PROGRESS is nil, or called now and then with the part of the way that is done."
  (let* ((run (new-run formula problem tolerance max-steps progress))
         (status (run-to-end run))
         (watcher (ended-watcher run))
         (times (times-of run)) (n (run-n run)) (kept (min (run-accepted run) (run-most-kept run))))
    (make-integration :times times
                      :states (subseq (run-states run) 0 (* n kept))
                      :steps (replace (make-array (min kept (floor *most-doubles* (funcall (formula-room formula) n)))
                                                  :initial-element nil)
                                      (run-steps run))
                      :interpolant (value-within-step (formula-value formula))
                      :checkpoints (coerce (nreverse (run-checkpoints run)) 'simple-vector)
                      :replay (taking-again run times)
                      :projector (run-projector run)
                      :sides (and watcher (sides-along run times))
                      :grazes (and watcher (reverse (watcher-grazes watcher)))
                      :beginnings (run-beginnings run)
                      :ended-by (and watcher (watcher-ended-by watcher))
                      :final (copy-seq (run-state run))
                      :largest (run-largest run)
                      :accepted (run-accepted run)
                      :rejected (run-rejected run)
                      :evaluations (run-evaluations run)
                      :implicit (formula-implicit formula)
                      :even (and (formula-even formula) (null watcher) (funcall (the function (formula-even formula))))
                      :stiffness (run-stiffness run)
                      :status status
                      :message (status-message status run))))

(defun ended-watcher (run)
  "The watcher of RUN, which has ended, or nil; what was noted on the way stands in vectors from now on, in its order."
  (let ((watcher (run-watcher run)))
    (setf (run-beginnings run) (in-order (run-beginnings run)))
    (when watcher (setf (watcher-pieces watcher) (in-order (watcher-pieces watcher))))
    watcher))

(defun taking-again (run times)
  "The function REPLAY of what comes of RUN."
  (let ((again nil))
    (lambda (states offset from to)
      (unless again (setq again (run-again run)))
      (steps-again run again times states offset from to))))

(defun run-again (run)
  "A run of the same steps, as far as its steps are told it."
  (let ((again (new-run (run-formula run) (run-problem run)
                        (make-tolerance :relative (with-control (run) (control relative))
                                        :absolute (run-absolute run))
                        0 nil)))
    (setf (run-projector again) (run-projector run))
    again))

(defun steps-again (old run times states offset from to)
  "What is kept of the steps of OLD at the places FROM to TO, not included, taken again by RUN; where the first begins,
STATES holds the state from OFFSET on."
  (declare (type double-array times states))
  (let ((kept (make-array (- to from))) (anew t))
    (place-run run states offset (aref times from))
    (loop for place from from below to
          do (let ((next (aref times (1+ place))))
               (when (or anew (begins-anew-p old place))
                 (when (run-watcher old) (take-piece run (piece-of-step (run-watcher old) place)))
                 (place-state run)
                 (funcall (formula-begin (run-formula run)) run))
               (setf (values (svref kept (- place from)) anew) (step-again run (aref times place) next))
               (move-on run)
               (place-time run next)))
    kept))

(defun step-again (run time next)
  "What is kept of the step of RUN from TIME to NEXT; as the second value whether it is no step like the others, and the
next one begins anew."
  (let ((formula (run-formula run)))
    (cond ((attempt-until run next)
           (project-end run)
           (handler-case (funcall (run-complete run) run)
             ((or domain-violation arithmetic-error) ()
               (prog1 (state-by-steps run time) (funcall (run-sketch run) run)))))
          (t (let ((value (state-by-steps run time)))
               (funcall value next (run-next run))
               (values value t))))))

(defun begins-anew-p (run place)
  "Whether the field has changed before the step at PLACE of a run that has ended."
  (let* ((beginnings (run-beginnings run)) (last (last-before beginnings place #'identity)))
    (and (>= last 0) (= place (svref beginnings last)))))

(defun attempt-until (run time)
  "Attempt a step that ends at TIME: whether anything came of it."
  (handler-case
      (with-control (run)
        (setf (control step) (flo (- (the double-float time) (control time))))
        (funcall (run-attempt run) run)
        (< (control error) 1d200))
    ((or domain-violation arithmetic-error) () nil)))

(defun state-by-steps (run start)
  "What stands for what cannot be kept of the step of RUN from START on, since that takes values of the field where it
has none, or since nothing comes of the step: a function (time out) that goes to TIME by steps of its own, halved where
they meet with such places."
  (let* ((states (copy-seq (run-state run))) (again (run-again run)) (formula (run-formula run)))
    (when (run-watcher run) (take-piece again (present-modes (run-watcher run))))
    (lambda (time out)
      (place-run again states 0 start)
      (funcall (formula-begin formula) again)
      (loop with end = time
            for now = (with-control (again) (control time))
            until (= now time)
            do (let ((trouble (handler-case (if (attempt-until again end)
                                                (progn (project-end again)
                                                       (funcall (run-sketch again) again)
                                                       nil)
                                                (make-condition 'arithmetic-error))
                                ((or domain-violation arithmetic-error) (condition) condition))))
                 (cond (trouble
                        (let ((middle (* 0.5d0 (+ now end))))
                          (when (or (= middle now) (= middle end)) (error trouble))
                          (setq end middle)))
                       (t (move-on again)
                          (place-time again end)
                          (setq end time)))))
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
      ((:ok :crawling :event) nil)
      (:undetermined (undetermined-sentence run time))
      (:interrupted (format nil "interrupted at time ~a" time))
      (:too-many-steps (format nil "~d steps were not enough: the motion was followed to time ~a"
                               (run-max-steps run) time))
      (:stiff (format nil "the equations are stiff: the motion was followed to time ~a" time))
      (:step-too-small
       (format nil "the step became too small at time ~a: ~a" time
               (if (times-sparse-p run)
                   (format nil "so late, times are doubles only every ~a; let time begin at 0"
                           (short-text (spacing-at (with-control (run) (control time)))))
                   "the motion has a singularity there, or no double is as accurate as it was asked to be")))
      (:not-finite (format nil "the rates grow without bound at time ~a" time))
      (:too-large (format nil "the motion ends at time ~a: states beyond ~a are too large for doubles; state them in ~
                               other units"
                          time (maxima-text +largest-size+)))
      (:domain (format nil "the motion ends at time ~a: ~a" time (trouble-as-given run))))))

(defun trouble-as-given (run)
  "What the field met with, without the sides of surfaces."
  (let ((trouble (run-trouble run)) (surfaces (problem-surfaces (run-problem run))))
    (if (and surfaces (typep trouble 'domain-violation) (violated-source trouble))
        (make-condition 'domain-violation :operation (violated-operation trouble)
                                          :source (as-given surfaces (violated-source trouble)))
        trouble)))

;;; Step after step

(declaim (inline steps-tried))
(defun steps-tried (run)
  (declare (type run run))
  (the fixnum (+ (the fixnum (run-accepted run)) (the fixnum (run-rejected run)))))

(defun advance (run)
  "Take steps until the end, or something else that ends the run: the status. Conditions of the field pass through."
  (declare (type run run))
  (let ((attempt (run-attempt run)) (watcher (run-watcher run)))
    (when (run-stale run) (begin-again run))
    (when (and watcher (watcher-lost watcher)) (return-from advance :undetermined))
    (with-control (run)
      (loop
        (loop while (and (run-stops run) (= (control time) (the double-float (first (run-stops run)))))
              do (pop (run-stops run))
                 (setf (control stop) (or (first (run-stops run)) (control end)))
                 (begin-piece run (control step) t))
        (setf (control left) (flo (- (control stop) (control time)))
              (control wanted) (control step))
        (poll)
        (cond ((= (control time) (control end)) (return :ok))
              ((interrupted-p) (return :interrupted))
              ((>= (steps-tried run) (run-max-steps run)) (return :too-many-steps))
              ((<= (flo (abs (control left))) (flo (* 1.01d0 (abs (control step)))))
               (setf (control step) (control left)))
              ((step-negligible-p run) (return :step-too-small))
              ;; a step that the time can be moved by exactly: else time and state would part by roundings
              (t (setf (control step) (flo (- (+ (control time) (control step)) (control time))))))
        (funcall attempt run)
        (let ((status (cond ((not (<= (control error) 1d0)) (reject-step run) nil)
                            (watcher (watched-step run))
                            (t (complete-step run)
                               (finish-step run)))))
          (when status (return status)))
        (when (run-progress run) (report-progress run))))))

(defun complete-step (run)
  "Go to the end of a step that is good; of the first ones, what the formula keeps of steps is kept."
  (declare (type run run))
  (project-end run)
  (if (kept-whole-p run) (note-whole run (whole-step run)) (sketch-step run)))

(defun kept-whole-p (run) (< (run-accepted run) (run-most-whole run)))

(defun note-whole (run kept)
  (let ((steps (run-steps run)) (place (run-accepted run)))
    (declare (simple-vector steps) (fixnum place))
    (when (>= place (length steps))
      (setf steps (replace (make-array (min (run-most-whole run) (max *room* (* 2 place))) :initial-element nil) steps)
            (run-steps run) steps))
    (setf (svref steps place) kept)))

(defun sketch-step (run) (funcall (run-sketch run) run))

(defun whole-step (run)
  "What is kept of the step; nil, where that takes values of the field where it has none: then the step is sketched."
  (let ((safe (run-safe run)))
    (if (and safe (funcall (the function safe) run))
        (funcall (run-complete run) run)
        (handler-case (funcall (run-complete run) run)
          ((or domain-violation arithmetic-error) () (sketch-step run) nil)))))

(defun finish-step (run)
  "The step, which is completed, is accepted, and the next one chosen; nil, or the status if the run ends here."
  (declare (type run run))
  (with-control (run)
    (let ((there (= (control step) (control left))))
      (watch-stability run)
      (accept-step run)
      (when there (place-time run (control stop)))
      (cond ((too-large-p run) :too-large)
            ((impatient-p run) :stiff)
            (t (funcall (run-choose run) run)
               (when there
                 (setf (control step) (flo (* (control direction) (max (abs (control step)) (abs (control wanted)))))))
               (let ((observer (run-observer run)))
                 (and observer (eq :crawling (funcall (the function observer) (run-in run))) :crawling)))))))

(defun begin-piece (run step fresh)
  "Begin afresh where the run is, since the field changes, with STEP at most; FRESH: with one that is found anew."
  (declare (double-float step))
  (unless (eql (run-accepted run) (first (run-beginnings run))) (push (run-accepted run) (run-beginnings run)))
  (setf (run-stale run) t)
  (with-control (run) (setf (control step) (* (control direction) (abs step))))
  (place-state run)
  (size-states-at-rest run)
  (let ((rates (funcall (formula-begin (run-formula run)) run)))
    (setf (run-stale run) nil)
    (with-control (run)
      (setf (control step) (* (control direction) (abs step))
            (control previous-error) 1d-4
            (run-after-rejection run) nil)
      (when (and fresh rates)
        (guess-step run rates)
        (when (> (abs (control step)) (abs step)) (setf (control step) (* (control direction) (abs step))))
        (place-state run)))))

(defparameter *moment* 1d-9 "The part of the whole time in which what is set in motion gets some size.")

(defun size-states-at-rest (run)
  "Of states that have been at rest in 0, and of whose size nothing is known, the new rates tell, of others than these."
  (with-run (run)
    (let ((absolute (run-absolute run)) (rates nil) (part 0d0) (largest 0d0))
      (declare (type double-array absolute) (double-float part largest))
      (dotimes (i n)
        (when (and (zerop (aref absolute i)) (zerop (aref state i)))
          (unless rates
            (setq rates (zeros n) part (* (control relative) *moment* (abs (- (control end) (control start)))))
            (incf (run-evaluations run))
            (funcall field in rates)
            (setq largest (reduce #'max rates :key #'abs)))
          (setf (aref absolute i) (min 1d200 (* part (max (abs (aref rates i)) (* 1d-6 largest))))))))))

(defun place-state (run)
  "State and time as the field is to see them, after it has seen others."
  (replace (run-in run) (run-state run))
  (with-control (run) (place-time run (control time))))

;;; Steps that are searched for kinks and events

(defun watched-step (run)
  "What becomes of a good attempt where kinks or events are watched: it is accepted, or taken again; nil, or the status
if the run ends here."
  (declare (type run run))
  (let* ((dense (progn (setf (run-stale run) t)
                       (project-end run)
                       (funcall (run-complete run) run)))
         (found (first-switching run dense)))
    (cond ((and (null found) (parted-in-second-p run (with-control (run) (control step))) (piece-ends-soon-p run dense))
           (begin-again run)
           (shorten-step run 0.6d0)
           nil)
          ((null found)
           (setf (run-stale run) nil)
           (when (kept-whole-p run) (note-whole run dense))
           (finish-step run))
          ((eq found :unresolved)
           (begin-again run)
           (shorten-step run 0.5d0)
           nil)
          (t (begin-again run)
             (switch-at run found)))))

(defun begin-again (run)
  "Take back that the step was completed."
  (let ((step (with-control (run) (control step))))
    (setf (run-stale run) t)
    (place-state run)
    (funcall (formula-begin (run-formula run)) run)
    (setf (run-stale run) nil)
    (with-control (run) (setf (control step) step))))

(defun switch-at (run switching)
  "Go to the time of SWITCHING, and on from there on other sides: nil, or the status if the run ends there."
  (with-control (run)
    (let ((way (flo (- (switching-time switching) (control time)))))
      (declare (double-float way))
      (cond ((at-once-p run (switching-time switching)) (switch-here run switching))
            ((parted-in-second-p run way) (setf (control step) (* 0.6d0 way)) nil)
            (t (setf (control step) way)
               (cond ((not (end-step-on-surface run switching)) (reject-step run) nil)
                     (t (complete-step run)
                        (accept-step run)
                        (let ((observer (run-observer run)))
                          (when observer (funcall (the function observer) (run-in run))))
                        (switch-here run switching))))))))

(defparameter *least-parted* 1d-12 "The part of the time that a step is to take so that parts of it are steps, too.")

(defun parted-in-second-p (run step)
  "Whether a STEP that is a whole piece between kinks, or most of it, is to be two: the other integration takes it as
one, and what an implicit method has within it is less accurate than its end, and would be the same in both.  Where two
kinks, or a kink and a breakpoint, are as near one another as times are rounded, nothing is between."
  (and (problem-noise (run-problem run))
       (problem-surfaces (run-problem run))
       (formula-implicit (run-formula run))
       (piece-begins-p run)
       (with-control (run) (> (abs step) (* *least-parted* (abs (control time)))))))

(defparameter *soon* '(0.2d0 0.4d0 0.65d0) "Parts of a step behind its end.")

(defun piece-ends-soon-p (run dense)
  "Whether a side seems to change soon after the step that was completed, or it ends near where steps must end."
  (with-control (run)
    (or (< (abs (control left)) (* (+ 1d0 (the double-float (first (last *soon*)))) (abs (control step))))
        (handler-case
            (some (lambda (part) (side-changes-by-p run dense (+ (control time) (* (+ 1d0 part) (control step)))))
                  *soon*)
          ((or domain-violation arithmetic-error) () nil)))))

(defun end-step-on-surface (run switching)
  "Attempt the step, and others a little longer or shorter, until its end is on the surface to rounding: what is seen of
the motion between its ends is less accurate than where they are.  Whether the attempt was good."
  (let ((attempt (run-attempt run)) (slope (switching-slope switching))
        (best-step nil) (best nil))
    (with-control (run)
      (loop repeat 4
            do (funcall attempt run)
               (unless (<= (control error) 1d0) (return-from end-step-on-surface nil))
               (let ((value (watched-at-end run switching)))
                 (when (and best (>= (abs value) (abs best))) (return))
                 (setq best value best-step (control step))
                 (when (or (zerop slope) (<= (abs value) (switching-rounding switching))) (return))
                 (let* ((longer (- (control step) (/ value slope)))
                        (exact (- (+ (control time) longer) (control time))))
                   (unless (and (plusp (* exact (control direction)))
                                (< (abs (- exact best-step)) (* 0.1d0 (abs best-step))))
                     (return))
                   (when (= exact best-step) (return))
                   (setf (control step) exact))))
      (unless (= (control step) best-step)
        (setf (control step) best-step)
        (funcall attempt run))
      t)))

(defun switch-here (run switching)
  "Change sides where the run is: nil, or the status if it ends here."
  (let* ((noise (problem-noise (run-problem run)))
         (before (and noise (rates-here run)))
         (status (change-sides run switching)))
    (unless status
      (when noise (shake-state run noise before (rates-here run)))
      (begin-piece run (* (with-control (run) (control wanted)) (factor-if-second run 0.6d0)) nil))
    status))

(defun rates-here (run)
  "The rates where the run is, on the sides that it is on; nil if there are none."
  (let ((rates (zeros (run-n run))))
    (place-state run)
    (incf (run-evaluations run))
    (handler-case (progn (funcall (the function (run-field run)) (run-in run) rates) rates)
      ((or domain-violation arithmetic-error) () nil))))

(defparameter *rounding-of-times* 2.3d-16 "The part of a time by which single changes of side may be early or late.")
(defparameter *lateness-of-switchings* 1.2d-16
  "The part by which they all are made to be late: that is some times what is left of many roundings to both sides.")

(defun shake-state (run factors before after)
  "Multiply the states by FACTORS, which change them by a unit in the last place, and move them by what the rates BEFORE
and AFTER differ in the time by which that of the switching may be rounded: pieces between kinks may be all alike, and
what roundings make of each of them, too; so it adds up, in both integrations alike.  As roundings do, N of these
changes add up to some sqrt(N) of the first.  Of each state by itself, they may cancel over a period; so does not what a
little lateness of all does together."
  (declare (type double-array factors))
  (let* ((state (run-state run)) (part (/ 1d0 (sqrt (+ 1d0 (length (run-beginnings run))))))
         (time (* part (abs (with-control (run) (control time)))))
         (late (* time *lateness-of-switchings* (with-control (run) (control direction)))))
    (declare (type double-array state) (double-float part time late))
    (dotimes (i (length state))
      (let ((change (- (aref factors i) 1d0)) (jump (jump-of-rate before after i)))
        (declare (double-float change jump))
        (setf (aref state i) (+ (* (aref state i) (+ 1d0 (* part change)))
                                (* (signum change) time *rounding-of-times* (abs jump))
                                (* late jump)))))))

(defun jump-of-rate (before after i)
  "The rate of the state I BEFORE less that AFTER; 0 where there are none, or they are no numbers."
  (let ((jump (if (and before after)
                  (- (aref (the double-array before) i) (aref (the double-array after) i))
                  0d0)))
    (if (< (abs jump) 1d200) jump 0d0)))

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

(defparameter *most-short-steps* 500
  "How many steps without a break may be shorter than 1e-9 of the way so far: at a singularity there is no end.")

(defparameter *crawling-steps* 20000
  "So many that have led no farther than 1e-20 of the whole way will not lead to its end.")

(defun step-negligible-p (run)
  (declare (type run run))
  (with-control (run)
    (let ((size (flo (abs (control step)))) (way (flo (abs (- (control time) (control start)))))
          (late (flo (abs (control time)))))
      (declare (double-float size way late))
      (if (<= size (flo (* 1d-9 way)))
          (incf (run-short run))
          (setf (run-short run) 0))
      (or (and (<= size (flo (* 2.3d-15 late)))
               (or (not (times-sparse-p run)) (<= size (flo (* 2.3d-16 late)))))
          (< size 1d-300)
          (> (run-short run) (the fixnum *most-short-steps*))
          (and (> (the fixnum (run-accepted run)) (the fixnum *crawling-steps*))
               (< (flo (* 1d20 way)) (flo (abs (- (control end) (control start))))))))))

(defun times-sparse-p (run)
  "Whether the time is so late that doubles there are far apart, seen from the length of the way."
  (with-control (run)
    (> (flo (* 2.3d-10 (abs (control time)))) (flo (abs (- (control end) (control start)))))))

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

(defun twice-as-long (array)
  "A copy of ARRAY, with room behind it."
  (declare (type (simple-array double-float (*)) array))
  (let ((longer (zeros (* 2 (length array)))))
    (declare (type (simple-array double-float (*)) longer))
    (with-fast-arithmetic
      (for (i (length array)) (setf (aref longer i) (aref array i)))
      longer)))

(defun note-state (run)
  "Keep the state at the beginning of the step that is being accepted."
  (declare (type run run))
  (let* ((n (run-n run)) (count (run-accepted run)) (place (fix (* n count))))
    (declare (fixnum n count place))
    (when (> (fix (+ place n)) (length (run-states run)))
      (setf (run-states run) (twice-as-long (run-states run))))
    (let ((states (run-states run)) (state (run-state run)))
      (declare (type (simple-array double-float (*)) states state))
      (with-fast-arithmetic
        (for (i n) (setf (aref states (fix (+ place i))) (aref state i)))
        nil))))

(defun note-checkpoint (run)
  (declare (type run run))
  (when (zerop (the fixnum (rem (fix (- (run-accepted run) (run-most-kept run))) (the fixnum *replayed*))))
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
    (declare (fixnum count))
    (when (>= (fix (+ count 1)) (length (run-times run)))
      (setf (run-times run) (twice-as-long (run-times run))))
    (with-control (run)
      (let ((times (run-times run)))
        (declare (type (simple-array double-float (*)) times))
        (setf (aref times count) (control time))
        nil))))

(defmacro natural-log (size)
  "Of a number that is positive."
  `(the double-float (#+gcl c-log #-gcl log (the (double-float (0d0)) ,size))))

(defmacro natural-exp (number) `(the double-float (#+gcl c-exp #-gcl exp ,number)))

(defmacro raised (base exponent)
  "For the choice of steps; where BASE is positive.  To raise exactly takes three times as long."
  `(natural-exp (flo (* ,exponent (natural-log ,base)))))

(defun choose-step (run)
  "The next step after one that was accepted."
  (with-control (run)
    (let* ((error (flo (max (control error) 1d-9)))
           (growth (flo (/ (* 0.9d0 (raised (control previous-error) +damping+)) (raised error (control exponent)))))
           (limit (if (run-after-rejection run) 1d0 6d0))
           (size (flo (min (* (abs (control step)) (min limit (max growth 0.333d0))) (control longest)))))
      (declare (double-float error growth limit size))
      (setf (control previous-error) (flo (max error 1d-4))
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
  (when (run-watcher run) (begin-watching run))
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
                 (factor-if-second run 0.6d0)
                 (min (control longest)
                      (max (if (formula-implicit (run-formula run))
                               (within-decay (min (* 100 trial) order-guess) slope (/ change trial))
                               (min (* 100 trial) order-guess))
                           (* 1d-14 (abs (control time)))))))))))          ; what is seen of so late a time

(defun within-decay (guess slope bend)
  "GUESS, or where it is far too long for that the time in which rates of the size SLOPE, which change by BEND in a unit
of time, would change altogether: what an implicit method steps over at the beginning it has wrong within that step.
Rates that come to nothing, in units of the tolerance, may change as they will."
  (if (and (> (* guess slope) 1d0) (< bend 1d200) (> (* guess bend) (* 100 slope)))
      (/ slope bend)
      guess))

(defun factor-if-second (run factor)
  "FACTOR in the second of two integrations, so that its steps begin elsewhere: what is the same in all steps, such as
roundings in a period, would be the same in both."
  (if (problem-noise (run-problem run)) factor 1d0))

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
