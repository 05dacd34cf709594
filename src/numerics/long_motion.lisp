;;; anmech: motions of many digits: integrated twice, like all others (accuracy.lisp), until they agree to the last one.
;;;
;;; A first pass of a third of the digits tells how much larger the error of a motion is than that of a step, in
;;; doubles if they have that many; the next one has the tolerance that this asks for, and bits beyond it, so that
;;; rounding takes no part.  The second integration of a pass has a tolerance ten times coarser, an odd order and other
;;; steps; the difference is its error, and an estimate on the safe side of that of the first, which is handed out.
;;; Along motions that are the same backwards, errors of even orders cancel more or less, by chance, and those of odd
;;; ones do not: so the first has an even order.  What is stepped over is looked for as in all motions (unseen.lisp);
;;; and where the motion of the doubles is another one, whose steps look more often, steps end where those do.
;;;
;;; Entry points: MOTION-IN-DIGITS, LONG-DIGITS, DIGITS-TROUBLE.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/accuracy" "numerics/dag" "numerics/doubles"
       "numerics/integration" "numerics/long_integration" "numerics/long_numbers" "numerics/motion" "numerics/progress"
       "numerics/series_program" "numerics/unseen")

;;; What is asked for

(defparameter *digits-of-doubles* 16)
(defparameter *most-digits* 10000)

(defun long-digits (options)
  "The option digits of an alist, if it asks for more than doubles have; nil otherwise."
  (let ((digits (cdr (assoc 'maxima::$digits options))))
    (and digits (integerp digits) (> digits *digits-of-doubles*) digits)))

(defun digits-trouble (options)
  "What is wrong with the option digits, a sentence, or nil."
  (let ((given (assoc 'maxima::$digits options)))
    (when given
      (unless (and (integerp (cdr given)) (<= 1 (cdr given) *most-digits*))
        (format nil "digits must be an integer from 1 to ~d, found ~a" *most-digits* (one-line (cdr given)))))))

(defun check-what-digits-leave (problem digits)
  "Complain of what such motions do not know."
  (let ((option (cond ((problem-events problem) "events") ((problem-breakpoints problem) "breakpoints")
                      ((problem-longest problem) "max_step") ((problem-projection problem) "project"))))
    (when option (complain "with digits = ~d there is no option ~a" digits option)))
  (when (problem-surfaces problem)
    (complain "digits = ~d needs equations without kinks (abs, signum, max, min, unit_step, conditionals)" digits)))

;;; One pass

(defstruct long-pass fine coarse error reached)

(defparameter *spare-bits* 40 "Beyond the tolerance: rounding in thousands of steps takes no part.")
(defparameter *compared-nodes* 24
  "At so many steps' ends, in as many parts of the time, and at the last, two integrations are compared.")

(defun with-domain-complaints (thunk)
  "What THUNK gives; what is made of parameters alone may have no value."
  (handler-case (funcall thunk)
    (domain-violation (condition) (complain "~a" condition))))

(defun bits-of-pass (tolerance) (+ (ceiling (- tolerance)) *spare-bits*))

(defun inputs-of-pass (task digits)
  "The states, the time and the parameters that TASK was given, and the time of its end: exact, or where they are
irrational to so many DIGITS, no fewer than the pass has, so that what the motion makes of their rounding is seen like
that of all rounding."
  (values (coerce (mapcar (lambda (form) (exact-value form digits)) (task-given task)) 'vector)
          (exact-value (task-given-end task) digits)))

(defun new-long-pass (program inputs end stops tolerance wanted most verify progress before)
  "TOLERANCE and WANTED are binary logarithms; BEFORE is the pass before this one, or nil."
  (let* ((bits (bits-of-pass tolerance)) (order (long-order tolerance))
         (fine (with-domain-complaints
                 (lambda ()
                   (integrate-long program inputs end stops tolerance order bits most (telling progress "")
                                   (and before (long-pass-fine before))))))
         (coarse (and verify
                      (not (interrupted-p))
                      (integrate-long program inputs end stops (+ tolerance (log 10d0 2d0)) (1- order) (- bits 5) most
                                      (telling progress "check of ") fine))))
    (multiple-value-bind (error reached)
        (if coarse (long-difference fine coarse wanted) (values nil (long-integration-time fine)))
      (make-long-pass :fine fine :coarse coarse :error error :reached reached))))

(defun long-difference (fine coarse wanted)
  "The binary logarithm of the largest difference of a state in proportion to its largest size so far, and the time
until which both go; nil for no difference.  Where the motion ends at an obstacle, until the difference is WANTED."
  (let* ((obstacle (long-obstacle-p fine)) (start (long-start fine))
         (end (if (> (abs (- (long-integration-time fine) start)) (abs (- (long-integration-time coarse) start)))
                  (long-integration-time coarse)
                  (long-integration-time fine)))
         (count (count-if (lambda (node) (<= (abs (- (first node) start)) (abs (- end start))))
                          (long-integration-nodes coarse)))
         (sizes (map 'vector (lambda (size) (and size (- size *begun-part*))) (long-integration-sizes fine)))
         (largest nil) (reached start) (last 0))
    (flet ((good-p (place)
             "Compare where the step at PLACE begins, or at the end."
             (multiple-value-bind (time states)
                 (if (= place count) (values end (long-states-at coarse end)) (long-node coarse place))
               (let* ((others (long-states-at fine time)) (seen (sizes-seen sizes others))
                      (error (greatest-of (loop for state across states
                                                for other across others
                                                for size across seen
                                                unless (= state other)
                                                  collect (- (binary-logarithm (- state other)) (or size 0))))))
                 (unless (and obstacle error (> error wanted))
                   (setq sizes seen largest (if (and error largest) (max error largest) (or error largest))
                         reached time last place)
                   t)))))
      (when (and (plusp count) (plusp (long-node-count fine)))
        (let ((bad (find-if-not #'good-p (compared-places coarse count start end obstacle))))
          (when bad
            (loop while (< (1+ last) bad)
                  do (let ((middle (ash (+ last bad) -1))) (unless (good-p middle) (setq bad middle))))))))
    (values largest reached)))

(defun compared-places (coarse count start end obstacle)
  "Of the first COUNT nodes of COARSE: some at equal numbers of steps, some in equal parts of the time from START to
END, and COUNT, which stands for the end."
  (let ((stride (max 1 (ceiling count (if obstacle (* 4 *compared-nodes*) *compared-nodes*)))) (last 0))
    (append (loop for place from 1 below count
                  for part = (floor (* *compared-nodes* (- (long-node coarse place) start)) (- end start))
                  when (or (zerop (rem place stride)) (> part last)) collect place
                  do (setq last part))
            (list count))))

(defun long-obstacle-p (integration)
  "Whether it ends because it cannot go on."
  (not (member (long-integration-trouble integration) '(nil :interrupted :too-many-steps :stiff :vanishing))))

;;; A motion

(defparameter *most-long-steps* 100000)
(defparameter *long-passes* 6)
(defparameter *first-tolerance* -27d0 "A binary logarithm: the first pass has eight digits, or more.")
(defparameter *finest-part* 6 "No tolerance has more than so many times the digits that are wanted.")

(defparameter *least-in-doubles* -40 "A binary logarithm: rounding takes no part in errors of such a tolerance.")

(defun first-long-tolerance (wanted most-steps error-in-doubles)
  "The tolerance of the first pass, which is that of the second where doubles tell it; what that took; and the motion of
these doubles with its error, a pair, or nil."
  (let* ((tolerance (min (/ wanted 3) *first-tolerance*)) (in-doubles (max tolerance *least-in-doubles*)))
    (multiple-value-bind (error evaluations motion) (funcall error-in-doubles (expt 2d0 in-doubles) most-steps)
      (values (if (and error (= tolerance in-doubles))
                  (next-long-tolerance tolerance (log error 2d0) wanted)
                  tolerance)
              evaluations
              (and error (cons motion error))))))

(defparameter *doubtful-error* 1d-3 "Of a motion of doubles, from which on it tells nothing.")
(defparameter *least-known* 1d-290 "A size below which doubles have fewer bits.")
(defparameter *same-in-doubles* 1d-9 "A difference, in proportion to the size of a state, that is none.")

(defun other-in-doubles-p (pass seen)
  "Whether the motion of PASS is another one than that of doubles, a pair of it and its error, as far as both go."
  (destructuring-bind (motion . error) seen
    (let* ((integration (motion-integration motion)) (times (integration-times integration))
           (fine (long-pass-fine pass)) (here (copy-seq (motion-start motion)))
           (start (long-start fine)) (way (abs (- (long-pass-reached pass) start))))
      (and (< error *doubtful-error*)
           (plusp (long-node-count fine))
           (loop for place from 0 below (length times) by (ceiling (length times) *compared-nodes*)
                 for time = (aref times place)
                   thereis (and (<= (abs (- (rational time) start)) way)
                                (progn (dense-value integration time here)
                                       (some (lambda (state other size)
                                               (and (> size *least-known*)
                                                    (> (abs (- (nearest-finite-double state) other))
                                                       (* (max *same-in-doubles* (* 100 error)) size))))
                                             (long-states-at fine (rational time))
                                             here (integration-largest integration)))))))))

(defun motion-in-digits (task error-in-doubles)
  "The motion of TASK with as many digits as its option says.  ERROR-IN-DOUBLES is a function (tolerance most-steps):
the error of the motion that such steps make of doubles, or nil; and the evaluations that this took."
  (let* ((digits (long-digits (task-options task))) (problem (task-problem task)) (model (problem-model problem))
         (n (problem-n problem)) (working (+ digits 20)))
    (check-what-digits-leave problem digits)
    (let* ((inputs nil) (end nil)
           (program (model-series-program model t))
           (most (or (task-max-steps task) *most-long-steps*))
           (wanted (- (* digits (log 10d0 2d0)))) (verify (task-verify task))
           (tolerance (- wanted 7)) (evaluations 0) (pass nil) (seen nil))
      (when verify
        (multiple-value-setq (tolerance evaluations seen) (first-long-tolerance wanted most error-in-doubles)))
      (flet ((follow (stops)
               (loop for number from 1 to *long-passes*
                     do (multiple-value-setq (inputs end)
                          (inputs-of-pass task (max working (digits-of-bits (bits-of-pass tolerance)))))
                        (setq pass (new-long-pass program inputs end stops tolerance wanted most verify
                                              (and (task-progress task) (progress-of-pass (task-progress task) number))
                                              pass))
                        (incf evaluations (evaluations-of-pass pass))
                        (when (or (not verify) (long-settled-p pass tolerance wanted)) (return))
                        (setq tolerance (next-long-tolerance tolerance (long-pass-error pass) wanted)))))
        (follow '())
        (when (and seen (other-in-doubles-p pass seen))
          (setq problem (with-breakpoints problem (coerce (integration-times (motion-integration (car seen))) 'list)))
          (follow (mapcar #'rational (problem-breakpoints problem))))
        (loop repeat *looks-again*
              for unseen = (unseen-by-pass pass problem)
              while unseen
              do (setq problem (with-breakpoints problem unseen))
                 (follow (mapcar #'rational (problem-breakpoints problem)))))
      (let ((motion (motion-of-long-pass pass model inputs digits)))
        (setf (motion-evaluations motion) evaluations
              (motion-message motion) (sentences (long-sentence pass wanted digits end)
                                                 (and seen (not (problem-timed problem)) (other-in-doubles-p pass seen)
                                                      "doubles lead to another motion: something was stepped over"))
              (motion-start motion) (problem-start problem))
        (when (and verify (long-pass-coarse pass))
          (setf (motion-error-estimate motion) (error-of-pass pass digits)))
        motion))))

(defparameter *seen-in-doubles* 1d-11 "What is smaller, in proportion to its size, doubles do not tell from rounding.")

(defparameter *parts-of-looks* 10 "Of the time between two looks for pulses.")
(defparameter *least-flank* 10 "So many looks to both sides of what doubles see, or as many as see it,")
(defparameter *most-flank* 40 "up to so many.")

(defun unseen-by-pass (pass problem)
  "Times where steps are to end, since they lead over a pulse, as far as doubles tell.  They see the middle of it, more
digits its flanks: so there are many, and some on both sides; none at the end, which is no double."
  (when (and (problem-timed problem) (plusp (long-node-count (long-pass-fine pass))))
    (let* ((start (problem-time problem)) (part (/ (- (problem-end problem) start) *looks-for-pulses* *parts-of-looks*))
           (unseen (unseen-times problem (double-integration (long-pass-fine pass)) *seen-in-doubles*))
           (flank (* *parts-of-looks* (max *least-flank* (min *most-flank* (length unseen)))))
           (count (* *looks-for-pulses* *parts-of-looks*)) (found '()) (last 0))
      (dolist (time (sort unseen (if (plusp part) #'< #'>)) (nreverse found))
        (let ((place (round (- time start) part)))
          (loop for k from (max (1+ last) (- place flank)) to (min (+ place flank) (1- count))
                do (push (+ start (* k part)) found)
                   (setq last k)))))))

(defun evaluations-of-pass (pass)
  (+ (long-integration-evaluations (long-pass-fine pass))
     (if (long-pass-coarse pass) (long-integration-evaluations (long-pass-coarse pass)) 0)))

(defun long-settled-p (pass tolerance wanted)
  "Whether the accuracy is reached, by a pass of such a tolerance; or nothing more is to be had."
  (or (null (long-pass-coarse pass))
      (member (long-integration-trouble (long-pass-fine pass)) '(:interrupted :too-many-steps))
      (and (<= tolerance wanted)
           (or (<= tolerance (* *finest-part* wanted))
               (member (long-integration-trouble (long-pass-fine pass)) '(:stiff :vanishing))
               (long-obstacle-p (long-pass-fine pass))
               (<= (or (long-pass-error pass) (* 2 wanted)) wanted)))))

(defun next-long-tolerance (tolerance error wanted)
  "That which will bring a fifth of the wanted error, if errors are proportional to tolerances; finer by half as many
digits again at most: an error that is as large as the motion tells nothing of that."
  (let ((growth (- (or error tolerance) tolerance)))
    (if (and error (> error -10))
        (max (* 2 tolerance) (* *finest-part* wanted))
        (min (- wanted 3) (- wanted (max 0 growth) 2.3d0)))))

(defun error-of-pass (pass digits)
  "As a double: at least what rounding does on the way, and of the values that are handed out."
  (let ((rounding (max (- 8 (long-field-bits (long-integration-field (long-pass-coarse pass))))
                       (- 1 (bits-of-digits (+ digits *more-digits*))))))
    (estimate-of-logarithm (max rounding (or (long-pass-error pass) rounding)))))

(defun estimate-of-logarithm (logarithm)
  "2^LOGARITHM: a double, or where it is too small for one, a bigfloat."
  (if (> logarithm -900)
      (two-digits (expt 2d0 logarithm))
      (bigfloat-near (expt 10 (ceiling logarithm (log 10d0 2d0))) *digits-of-doubles*)))

(defun long-sentence (pass wanted digits end)
  (let* ((fine (long-pass-fine pass)) (error (long-pass-error pass)) (reached (long-pass-reached pass)))
    (sentences (if (long-stiff-p fine)
                   (stiff-sentence fine reached end)
                   (or (long-trouble-sentence fine reached) (check-cut-short-sentence pass end)))
               (and error (> error wanted)
                    (format nil "~d digits were not reached, only ~d"
                            digits (max 0 (floor (- error) (log 10d0 2d0))))))))

(defun check-cut-short-sentence (pass end)
  (let ((coarse (long-pass-coarse pass)))
    (and coarse
         (/= (long-integration-time coarse) end)
         (format nil "the integration that checks ended at time ~a"
                 (maxima-text (to-double (long-pass-reached pass)))))))

(defun long-stiff-p (integration)
  "Whether its steps were too many, because stability bounds them."
  (and (long-integration-stiffness integration)
       (member (long-integration-trouble integration) '(:stiff :too-many-steps))
       (not (long-steps-vanish-p integration))))

(defun long-steps-vanish-p (integration)
  (way-of-vanishing-steps (long-integration-nodes integration) (long-integration-time integration)))

(defun stiff-sentence (integration reached end)
  (format nil "the equations are stiff: something decays at the rate ~a, which bounds the steps of power series long ~
               after it has died out: the motion was followed to time ~a; eliminate what decays so fast, or give ~
               max_steps = ~d and time; without digits there is a method for stiff equations"
          (short-text (cdr (long-integration-stiffness integration))) (maxima-text (to-double reached))
          (two-digits-above (long-steps-needed integration end))))

(defun long-trouble-sentence (integration reached)
  (let ((trouble (long-integration-trouble integration)) (time (maxima-text (to-double reached))))
    (case trouble
      ((nil) nil)
      (:interrupted (format nil "interrupted at time ~a" time))
      (:too-many-steps (format nil "~d steps were not enough: the motion was followed to time ~a; give max_steps"
                               (long-integration-accepted integration) time))
      (:stiff (format nil "the equations are stiff: the motion was followed to time ~a" time))
      (:vanishing
       (format nil "the motion ends at time ~a: its steps become shorter and shorter there, as near a singularity"
               time))
      (:too-short
       (format nil "the motion ends at time ~a: its steps become too short there, as near a singularity" time))
      (t (format nil "the motion ends at time ~a: ~a" time trouble)))))

(defun motion-of-long-pass (pass model inputs digits)
  (let ((integration (long-pass-fine pass)))
    (make-motion :model model :integration (double-integration integration)
                 :reached (to-double (long-pass-reached pass))
                 :long (make-long-record :integration integration :inputs inputs :digits digits
                                         :reached (long-pass-reached pass)))))

(defun double-integration (integration)
  "The same for those who read doubles."
  (let ((nodes (long-integration-nodes integration)))
    (make-integration :times (doubles (append (map 'list (lambda (node) (to-double (first node))) nodes)
                                              (list (to-double (long-integration-time integration)))))
                      :steps nodes
                      :interpolant (lambda (node time out n)
                                     (declare (ignore node n))
                                     (map-into (the double-array out) #'nearest-finite-double
                                               (long-states-at integration (time-within integration time))))
                      :final (map 'double-array #'nearest-finite-double (long-integration-states integration))
                      :largest (map 'double-array
                                    (lambda (size)
                                      (if size (scale-float 1d0 (max -1000 (min 1000 (ceiling size)))) 0d0))
                                    (long-integration-sizes integration))
                      :accepted (long-integration-accepted integration) :rejected 0
                      :evaluations (long-integration-evaluations integration)
                      :stiffness (and (not (long-steps-vanish-p integration)) (long-integration-stiffness integration))
                      :status (if (long-integration-trouble integration) :stopped :ok)
                      :message (long-trouble-sentence integration (long-integration-time integration)))))
