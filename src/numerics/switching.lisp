;;; anmech: where the sides of a motion change, and what is looked for on the way.
;;;
;;; A *watcher* goes with a run.  It has a number of functions of time and state: first the g of the surfaces where the
;;; field has kinks (surfaces.lisp), then those of events.  Each has a *mode*, the sign that it has at present; a step
;;; is searched for the first place where a function times its mode becomes negative.  Where a step begins, after a
;;; change, that may be so by roundings: it counts only if the same is found soon after.
;;;
;;; When g reaches zero and the rates beyond lead on, its mode changes.  When they lead back, the motion *slides* along
;;; the surface: the mode is 0, and the rates are A. F. Filippov's, the mean of those of both sides that is tangent to
;;; the surface; on several surfaces at once the signs are those that keep all g at zero (the equivalent control of V.
;;; I. Utkin), which is the same where the rates are linear in the signs, as in dry friction.  It leaves the surface
;;; where the mean becomes one of both.  Then the function that is watched is 4 w v, which is positive as long as both
;;; have a share.
;;;
;;; A step is searched at seven places.  A function that it does not follow (a cubic through four of them misses the
;;; others) may vanish anywhere in it: then the step is unresolved, and a shorter one is taken.
;;;
;;; Entry points: the structure WATCHER with WATCHER-ENDED-BY, WATCHER-GRAZES; NEW-WATCHER, WATCHED-FIELD,
;;; FIRST-SWITCHING, the structure SWITCHING, WATCHED-AT-END, CHANGE-SIDES, IN-ORDER, LAST-BEFORE, PIECE-OF-STEP,
;;; PIECE-BEGINS-P, PRESENT-MODES, TAKE-PIECE, SIDES-ALONG, SIDE-CHANGES-BY-P, UNDETERMINED-SENTENCE.
;;;
;;; Literature: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (1988); V. I. Utkin, Sliding
;;; Modes in Control and Optimization (1992); L. Dieci, L. Lopez, Sliding motion in Filippov differential systems,
;;; SIAM J. Numer. Anal. 47 (2009) 2023; L. F. Shampine, S. Thompson, Comput. Math. Appl. 39 (2000) 43.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "arithmetic/linear" "numerics/grazing" "numerics/integration"
       "numerics/surfaces" "numerics/zeros")

(defstruct watcher
  surfaces                       ; or nil
  (known 0 :type fixnum)         ; how many surfaces
  (events #() :type simple-vector)
  (modes #() :type simple-vector)      ; signs; of a surface 0 while the motion slides along it, of an event before the
                                       ; first sign is seen
  (largest nil :type double-array)     ; of each function, the largest size so far
  (recent nil :type double-array)      ; the same since its last change
  (before nil :type double-array)      ; and between that and the one before
  (grazes '())                         ; structures of grazing.lisp, the last first
  (graze-count 0 :type fixnum)         ; how many
  (idle #() :type simple-vector)       ; how often it has changed without going far
  (occurrences #() :type simple-vector)
  (sliding '())                  ; the surfaces with mode 0
  (resting nil)                  ; whether the run has come to rest: then nothing changes any more
  (point nil :type double-array) ; like the input of the field
  (values nil :type double-array)      ; what the function of the surfaces gives
  (rates nil :type double-array)
  (other nil :type double-array)
  (pieces '())                   ; pairs of the place of a step and the present modes from there on, the last first;
                                 ; when the run has ended, a vector of them in order
  (changes 0 :type fixnum)       ; how often sides have changed at one and the same time
  last-change                    ; that time
  (crowd 0 :type fixnum)         ; how often they have changed since
  (crowd-begins 0d0)             ; this time, which is not long ago
  lost                           ; the surface at which the motion was lost
  ended-by)                      ; the event that has ended it

(defun watched-count (watcher) (+ (watcher-known watcher) (length (watcher-events watcher))))

(defun new-watcher (problem)
  "Of the surfaces and events of PROBLEM; nil if it has none."
  (let* ((surfaces (problem-surfaces problem)) (events (coerce (problem-events problem) 'simple-vector))
         (known (if surfaces (surfaces-count surfaces) 0)) (count (+ known (length events))) (n (problem-n problem)))
    (when (plusp count)
      (make-watcher :surfaces surfaces :known known :events events
                    :modes (make-array count :initial-element 0) :occurrences (make-array count :initial-element 0)
                    :largest (zeros count) :recent (zeros count) :before (zeros count)
                    :idle (make-array count :initial-element 0)
                    :point (copy-seq (problem-start problem))
                    :values (zeros (if surfaces (surfaces-room surfaces) 0))
                    :rates (zeros n) :other (zeros n)))))

;;; The field

(defun watched-field (watcher run)
  "The field of RUN: on the sides of the modes, and sliding."
  (let* ((problem (run-problem run)) (smooth (problem-smooth-field problem)))
    (if (null (watcher-surfaces watcher))
        (problem-field problem)
        (lambda (in out)
          (let ((sliding (watcher-sliding watcher)))
            (cond ((watcher-resting watcher) (fill out 0d0))
                  ((null sliding) (funcall (the function smooth) in out))
                  ((null (rest sliding)) (slide-on-one watcher run smooth (first sliding) in out))
                  (t (slide-on-several watcher run smooth sliding in out)))
            nil)))))

(defun slide-on-one (watcher run smooth i in out)
  "The rates that are tangent to the surface I go to OUT, and its side to IN."
  (declare (type double-array in out) (type function smooth))
  (let* ((surfaces (watcher-surfaces watcher)) (values (watcher-values watcher)) (other (watcher-other watcher)))
    (declare (type double-array other))
    (incf (run-evaluations run))
    (put-side surfaces in i 1)
    (funcall smooth in other)
    (put-side surfaces in i -1)
    (funcall smooth in out)
    (find-values surfaces in values)
    (let* ((above (surface-rate surfaces i values other)) (below (surface-rate surfaces i values out))
           (share (if (= above below) 0.5d0 (/ below (- below above)))))
      (declare (double-float above below share))
      (put-side surfaces in i (- (* 2 share) 1))
      (with-fast-arithmetic
        (for (k (length out))
          (setf (aref out k) (flo (+ (* share (aref other k)) (* (- 1d0 share) (aref out k)))))))
      (unless (= above below) (remove-surface-rate surfaces i values out)))))

(defun slide-on-several (watcher run smooth sliding in out)
  "The same for all surfaces of the list SLIDING."
  (declare (type double-array in out) (type function smooth))
  (let* ((surfaces (watcher-surfaces watcher)) (values (watcher-values watcher)) (other (watcher-other watcher))
         (size (length sliding)) (matrix (zeros (* size size))) (right (zeros size)))
    (flet ((rates-of-surfaces (array)
             (mapcar (lambda (i) (surface-rate surfaces i values array)) sliding)))
      (incf (run-evaluations run) (* 2 size))
      (dolist (i sliding) (put-side surfaces in i 0))
      (find-values surfaces in values)
      (funcall smooth in out)
      (loop for rate in (rates-of-surfaces out) for row from 0 do (setf (aref right row) (- rate)))
      (loop for i in sliding
            for column from 0
            do (put-side surfaces in i 1)
               (funcall smooth in out)
               (put-side surfaces in i -1)
               (funcall smooth in other)
               (put-side surfaces in i 0)
               (loop for above in (rates-of-surfaces out)
                     for below in (rates-of-surfaces other)
                     for row from 0
                     do (setf (aref matrix (+ (* size row) column)) (* 0.5d0 (- above below)))))
      (unless (solve-linear-in-place size matrix right) (fill right 0d0))
      (loop for i in sliding for k from 0 do (put-side surfaces in i (aref right k)))
      (funcall smooth in out)
      (dolist (i sliding) (remove-surface-rate surfaces i values out)))))

;;; The functions that are watched

(defun put-modes (watcher point)
  "Note the sides of the modes in POINT."
  (let ((surfaces (watcher-surfaces watcher)))
    (when surfaces
      (dotimes (i (watcher-known watcher)) (put-side surfaces point i (svref (watcher-modes watcher) i))))
    point))

(defun plain-values (run point out)
  "The values of all g, of surfaces and events, at POINT go to OUT."
  (let* ((watcher (run-watcher run)) (surfaces (watcher-surfaces watcher)) (values (watcher-values watcher)))
    (when surfaces
      (find-values surfaces point values)
      (replace out values :end2 (watcher-known watcher))
      (let ((noise (problem-noise (run-problem run)))) (when noise (add-noise surfaces values point noise out))))
    (loop for event across (watcher-events watcher)
          for j from (watcher-known watcher)
          do (setf (aref out j) (value-of-event event point)))
    out))

(defconstant +no-value+ most-positive-double-float "What stands for the value of an event where it has none.")

(defun value-of-event (event point)
  (let ((value (handler-case (funcall (the function (event-function event)) point)
                 ((or domain-violation arithmetic-error) () +no-value+))))
    (if (< (abs value) +no-value+) value +no-value+)))

(defun has-value-p (value) (< (abs value) +no-value+))

(defun add-noise (surfaces values point factors out)
  "Change all g in OUT as if the states were multiplied by FACTORS, and the time moved by a unit in the last place, to
one side or the other."
  (declare (type double-array values point factors out))
  (let ((n (length factors)))
    (loop for (i . variable) in (surfaces-entries surfaces)
          for place from (surfaces-count surfaces)
          do (incf (aref out i) (* (aref values place) (aref point variable)
                                   (cond ((< variable n) (- (aref factors variable) 1d0))
                                         ((evenp i) 2.3d-16)
                                         (t -2.3d-16)))))))

(defun watched-values (run point out)
  "The values at POINT that are positive as long as no side changes go to OUT."
  (declare (type double-array out))
  (let* ((watcher (run-watcher run)) (modes (watcher-modes watcher)))
    (when (watcher-sliding watcher)
      (funcall (the function (run-field run)) point (watcher-rates watcher))
      (incf (run-evaluations run)))
    (plain-values run point out)
    (dotimes (j (length out) out)
      (setf (aref out j) (* (svref modes j) (aref out j))))
    (when (watcher-resting watcher) (return-from watched-values (fill out 1d0 :end (watcher-known watcher))))
    (dolist (i (watcher-sliding watcher) out)
      (let ((side (side-at (watcher-surfaces watcher) point i)))
        (setf (aref out i) (- 1d0 (* side side)))))))

(defun point-of-step (run dense time)
  "The point of the watcher at TIME, within the step that was completed and of which the method keeps DENSE."
  (let* ((watcher (run-watcher run)) (point (watcher-point watcher)) (n (run-n run)))
    (with-control (run)
      (cond ((= time (control time)) (replace point (run-state run)))
            ((= time (flo (+ (control time) (control step)))) (replace point (run-next run)))
            (t (funcall (the function (formula-value (run-formula run))) dense time point n))))
    (setf (aref point n) time)
    point))

(defun point-at-end (run)
  "The point of the watcher where an attempt ends."
  (let ((point (watcher-point (run-watcher run))))
    (replace point (run-next run))
    (with-control (run) (setf (aref point (run-n run)) (flo (+ (control time) (control step)))))
    point))

;;; The first change in a step

(defstruct switching
  function          ; the number of that which vanishes
  time
  slope             ; of what is watched, there
  rests             ; whether it vanishes from there on
  rounding)         ; what is as good as zero

(defun watched-at-end (run switching)
  "The value at the end of an attempt."
  (aref (watched-values run (point-at-end run) (zeros (watched-count (run-watcher run))))
        (switching-function switching)))

(defun places-in-step (start step)
  "Seven times, equidistant."
  (loop for k from 0 to 6 collect (if (= k 6) (+ start step) (+ start (* k (/ step 6d0))))))

(defun first-switching (run dense)
  "The first switching in a step that was completed, :unresolved, or nil."
  (let* ((watcher (run-watcher run)) (count (watched-count watcher)) (first nil) (unresolved nil))
    (put-modes watcher (watcher-point watcher))
    (with-control (run)
      (let* ((start (control time)) (step (control step))
             (long (> (abs step) (* 1d-9 (abs (- (control end) (control start))))))
             (times (places-in-step start step))
             (rows (mapcar (lambda (time)
                             (copy-seq (watched-values run (point-of-step run dense time) (zeros count))))
                           times)))
        (flet ((value (j) (lambda (time)
                            (aref (watched-values run (point-of-step run dense time) (zeros count)) j))))
          (dotimes (j count)
            (note-first-sign run j dense times rows)
            (multiple-value-bind (times values)
                (where-it-is run j (value j) times (mapcar (lambda (row) (aref row j)) rows))
              (note-largest watcher j values)
              (when (and (< j (watcher-known watcher)) (not (eql 0 (svref (watcher-modes watcher) j))))
                (note-grazes run j (value j) dense times values))
              (let* ((rest (time-of-rest watcher j (value j) times values))
                     (zero (cond ((null values) nil)
                                 (rest (and (looked-for-p watcher j) rest))
                                 ((and (= (length values) 7) (unresolved-p watcher j values)) (setq unresolved t) nil)
                                 ((not (looked-for-p watcher j)) nil)
                                 (t (first-zero (value j) times values (rounding-of watcher j))))))
                (when (and zero long (back-at-once-p watcher j zero times values)) (setq unresolved t zero nil))
                (when (and zero (or (null first) (sooner-p run zero (switching-time first))))
                  (setf first (switching-near (value j) j zero times watcher)
                        (switching-rests first) (and rest t))))))
          (if (and unresolved long) :unresolved first))))))

(defun rounding-of (watcher j) (* 1d-14 (aref (watcher-largest watcher) j)))

(defun back-at-once-p (watcher j zero times values)
  "Whether the surface J, which would be met at the time ZERO, where the step begins, is left later in the step.  It may
be that it is left along a tangent, and that what a method sees of the motion within a long step is less accurate than
that."
  (and (< j (watcher-known watcher)) (= zero (first times)) (> (reduce #'max values) (rounding-of watcher j))))

(defun side-changes-by-p (run dense time)
  "Whether the side of a surface has changed at TIME, a little beyond the step, as the step seems to go on."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))))
    (put-modes watcher (watcher-point watcher))
    (watched-values run (point-of-step run dense time) values)
    (some #'minusp (subseq values 0 (watcher-known watcher)))))

(defun sooner-p (run time other)
  (with-control (run) (plusp (* (control direction) (- other time)))))

(defun looked-for-p (watcher j)
  "Whether a step must end where the function J vanishes; not so for events that end nothing."
  (or (< j (watcher-known watcher)) (event-terminal (svref (watcher-events watcher) (- j (watcher-known watcher))))))

(defun note-largest (watcher j values)
  (dolist (value values)
    (setf (aref (watcher-largest watcher) j) (max (aref (watcher-largest watcher) j) (abs value))
          (aref (watcher-recent watcher) j) (max (aref (watcher-recent watcher) j) (abs value)))))

;; Where a surface is grazed

(defparameter *near-zero* 1d-4
  "An extreme value of g may be due to errors if it is this part of what g has been on this side, or the one before.")

(defun note-grazes (run j value dense times values)
  "Keep where g of the surface J, with VALUES at TIMES of a step, has an extreme next to zero."
  (let* ((watcher (run-watcher run)) (recent (aref (watcher-recent watcher) j))
         (before (aref (watcher-before watcher) j)) (noise (* 1d-12 (aref (watcher-largest watcher) j))))
    (when (< (reduce #'min values :key #'abs) (* 0.1d0 (max recent before)))
      (loop for (time . bend) in (extremes times values noise)
            do (let* ((near (* *near-zero* (if (plusp bend) recent before)))
                      (time (refined-extreme value time times noise))
                      (extreme (funcall value time)))
                 (when (and (<= (- (rounding-of watcher j)) extreme near)      ; below, the surface is met before
                            (not (and (= time (first times)) (piece-begins-p run))))
                   (let ((graze (graze-at run j dense time (max 0d0 extreme) bend)))
                     (when graze (keep-graze watcher graze)))))))))

(defparameter *most-grazes* 10000 "So many are kept; of more, the half that comes nearest to the surface.")

(defun keep-graze (watcher graze)
  (push graze (watcher-grazes watcher))
  (when (> (incf (watcher-graze-count watcher)) *most-grazes*)
    (let* ((half (floor *most-grazes* 2))
           (limit (graze-depth (nth half (sort (copy-list (watcher-grazes watcher)) #'< :key #'graze-depth))))
           (kept (remove-if (lambda (graze) (> (graze-depth graze) limit)) (watcher-grazes watcher))))
      (setf (watcher-grazes watcher) (subseq kept 0 (min half (length kept)))
            (watcher-graze-count watcher) half))))

(defun piece-begins-p (run) (eql (run-accepted run) (or (first (run-beginnings run)) 0)))

(defun extreme-of-parabola (middle width early here late noise)
  "Where the parabola through the values EARLY, HERE and LATE, by WIDTH apart, HERE at MIDDLE, is extreme; nil if it is
nowhere near, or bends by no more than NOISE.  The second value is its second derivative."
  (let ((bend (+ early (* -2 here) late)) (fall (- early late)))
    (if (and (< (abs fall) (* 10 (abs bend))) (> (abs bend) noise) (> (* width width) 1d-300))
        (values (+ middle (* width (/ fall (* 2 bend)))) (/ bend (* width width)))
        nil)))

(defun extremes (times values noise)
  "Pairs of times, between the first and the last of TIMES, at which parabolas through VALUES are extreme, and of their
second derivatives.  One where a step begins or ends may be found in both; what is no more than NOISE is none."
  (let* ((width (- (second times) (first times))) (first (first times)) (last (first (last times))))
    (loop for (early middle late) on times
          for (at-early at-middle at-late) on values
          while late
          append (multiple-value-bind (time bend) (extreme-of-parabola middle width at-early at-middle at-late noise)
                   (and time
                        (<= (abs (- time middle)) (* (if (or (= early first) (= late last)) 1.1d0 0.6d0) (abs width)))
                        (list (cons (between first time last) bend)))))))

(defun between (first time last) (if (< first last) (max first (min last time)) (min first (max last time))))

(defun refined-extreme (function time times noise)
  "The time of the extreme of FUNCTION near TIME, between the first and the last of TIMES, by shorter and shorter
parabolas, as long as they are more than NOISE."
  (let* ((first (first times)) (last (first (last times))) (step (- last first)))
    (dolist (part '(0.05d0 0.005d0) time)
      (let* ((width (* part step)) (middle (between (+ first width) time (- last width)))
             (found (extreme-of-parabola middle width (funcall function (- middle width)) (funcall function middle)
                                         (funcall function (+ middle width)) noise)))
        (unless found (return time))
        (setq time (between first found last))))))

(defun graze-at (run j dense time extreme bend)
  "The structure, where g has the size EXTREME at TIME; nil where the rates do not jump."
  (let* ((watcher (run-watcher run)) (surfaces (watcher-surfaces watcher)) (values (watcher-values watcher))
         (n (run-n run)) (above (zeros n)) (below (zeros n))
         (smooth (problem-smooth-field (run-problem run)))
         (point (put-modes watcher (copy-seq (point-of-step run dense time)))))
    (handler-case
        (progn
          (find-values surfaces point values)
          (put-side surfaces point j 1)
          (funcall (the function smooth) point above)
          (put-side surfaces point j -1)
          (funcall (the function smooth) point below)
          (incf (run-evaluations run) 2)
          (let ((jumps (map-doubles ((a above) (b below)) (abs (- a b)))) (mode (svref (watcher-modes watcher) j)))
            (and (some #'plusp jumps)
                 (make-graze :time time :depth extreme :bend (abs bend) :beyond (minusp bend) :jumps jumps
                             :back (max 0d0 (with-control (run)
                                              (* mode (control direction)
                                                 (surface-rate surfaces j values (if (plusp mode) below above)))))
                             :slopes (loop for (surface . variable) in (surfaces-entries surfaces)
                                           for place from (surfaces-count surfaces)
                                           when (= surface j) collect (cons variable (abs (aref values place))))))))
      ((or domain-violation arithmetic-error) () nil))))

(defun note-first-sign (run j dense times rows)
  "Of an event that vanished where the run began, the sign soon after; ROWS, what is watched at TIMES, are put right."
  (let ((watcher (run-watcher run)))
    (when (and (>= j (watcher-known watcher)) (eql 0 (svref (watcher-modes watcher) j)))
      (flet ((value (time)
               (aref (plain-values run (point-of-step run dense time) (zeros (watched-count watcher))) j)))
        (let ((sign (round (signum (value (+ (first times) (* 1d-3 (- (second times) (first times)))))))))
          (setf (svref (watcher-modes watcher) j) sign)
          (loop for row in rows
                for time in times
                do (setf (aref row j) (* sign (value time)))))))))

(defun where-it-is (run j value times values)
  "The first of TIMES at which the event J has values, up to where it has none, and these; two values.  If it has none
before, its sign is that of the first."
  (let ((watcher (run-watcher run)))
    (if (or (< j (watcher-known watcher)) (every #'has-value-p values))
        (values times values)
        (let ((stretch (first (stretches (lambda (time) (has-value-p (funcall value time))) times))))
          (when (and stretch (/= (first stretch) (first times)) (minusp (funcall value (first stretch))))
            (setf (svref (watcher-modes watcher) j) (- (svref (watcher-modes watcher) j))))
          (if (rest stretch)
              (values stretch (mapcar value stretch))
              (values nil nil))))))

(defun time-of-rest (watcher j function times values)
  "When the event J, which had a sign, has come to rest at zero: its last VALUES are one and the same, and rounding; nil
if it has not.  If it fades, it has no sign from there on."
  (let* ((modes (watcher-modes watcher)) (end (first (last values))))
    (when (and (>= j (watcher-known watcher)) values (not (eql 0 (svref modes j)))
               (<= (abs end) (* 1d-15 (aref (watcher-largest watcher) j))))
      (let* ((place (position end values :test #'/= :from-end t))
             (time (if place
                       (last-place (lambda (time) (/= (funcall function time) end))
                                   (nth place times) (nth (1+ place) times))
                       (first times))))
        (cond ((and place (< 0 (abs (funcall function time)) *faded*)) (setf (svref modes j) 0) nil)
              ((or (= end (first (last values 2))) (stays-p function end time times)) time))))))

(defun stays-p (function value from times)
  "Whether FUNCTION is VALUE all along from FROM to the last of TIMES, and for more than a moment: what has come to rest
shortly before a step ends would be told late in the next one."
  (let ((way (- (first (last times)) from)))
    (and (> (abs way) (* 1d-9 (abs (- (first (last times)) (first times)))))
         (every (lambda (part) (= value (funcall function (+ from (* part way))))) '(0.25d0 0.5d0 0.75d0)))))

(defun unresolved-p (watcher j values)
  "Whether VALUES of the function J are no values of a function that may be followed, and might vanish between."
  (destructuring-bind (a b c d e f g) values
    (let* ((miss (max (abs (- b (/ (+ (* 5 a) (* 15 c) (* -5 e) g) 16)))
                      (abs (- d (/ (+ (- a) (* 9 c) (* 9 e) (- g)) 16)))
                      (abs (- f (/ (+ a (* -5 c) (* 15 e) (* 5 g)) 16)))))
           (largest (reduce #'max values :key #'abs)))
      (and (> miss (* 0.1d0 largest))
           (> miss (* 1d-12 (aref (watcher-largest watcher) j)))
           (< (reduce #'min values) (* 3 miss))))))

(defun first-zero (function times values rounding)
  "The first of the TIMES, or a time between, at which FUNCTION, with VALUES there, becomes negative by more than
ROUNDING; or nil."
  (loop for (low . later) on times
        for (at-low . values-later) on values
        for before = nil then here
        for here = (list low at-low)
        while later
        do (let ((high (first later)) (at-high (first values-later)))
             (cond ((< at-high (- rounding))
                    (return (zero-after function low high at-low at-high rounding)))
                   (t (let ((place (dip function low high (rest later) at-low at-high (rest values-later) before
                                        rounding)))
                        (when place
                          (return (zero-after function low place at-low (funcall function place) rounding)))))))))

(defun zero-after (function low high at-low at-high rounding)
  "The zero between LOW and HIGH; LOW itself if FUNCTION is not positive soon after."
  (if (> at-low rounding)
      (enclosed-zero function low high at-low at-high)
      (loop repeat 45
            for width = (/ (- high low) 2) then (/ width 2)
            for place = (+ low width)
            for value = (funcall function place)
            until (= place low)
            do (when (> value rounding)
                 (return (enclosed-zero function place (+ place width) value (funcall function (+ place width)))))
            finally (return low))))

(defun dip (function low high later at-low at-high values-later before rounding)
  "A place between LOW and HIGH where FUNCTION, positive at both, is below -ROUNDING: looked for where a parabola
through them and a neighbour comes near to zero between them; or nil."
  (flet ((lowest (other at-other)
           ;; of the parabola, the value where it has a minimum between; late, places of short steps may be the same
           (unless (or (= low high) (= other low) (= other high))
             (let* ((width (- high low)) (x (/ (- other low) width)) (rise (- at-high at-low))
                    (bend (/ (- (/ (- at-other at-low) x) rise) (- x 1))))
               (when (plusp bend)
                 (let ((place (* 0.5d0 (- 1 (/ rise bend)))))
                   (and (< 0 place 1) (- at-low (* bend place place)))))))))
    (let ((values (remove nil (list (and before (lowest (first before) (second before)))
                                    (and later (lowest (first later) (first values-later)))))))
      (and values
           (< (reduce #'min values) (* 0.25d0 (min at-low at-high)))
           (place-below (- rounding) function low high)))))

(defun switching-near (function j time times watcher)
  "The switching of the function J at TIME; the slope is that of a short chord."
  (let* ((first (first times)) (last (first (last times))) (width (* 1d-4 (- last first)))
         (before (if (> (abs (- time first)) (abs width)) (- time width) time))
         (after (if (> (abs (- last time)) (abs width)) (+ time width) time)))
    (make-switching :function j :time time
                    :slope (if (= before after)
                               0d0
                               (/ (- (funcall function after) (funcall function before)) (- after before)))
                    :rounding (* 4d-16 (aref (watcher-largest watcher) j)))))

;;; Changes

(defparameter *most-changes* 40
  "How often sides may change at one and the same time, or within 1e-7 of the way so far, or without a way between that
is more than rounding: else they accumulate.")

(defun accumulating-p (run j time)
  "Count a change of the side of the surface J at TIME; whether they are too many there."
  (let ((watcher (run-watcher run)) (start (with-control (run) (control start))))
    (if (eql time (watcher-last-change watcher))
        (incf (watcher-changes watcher))
        (setf (watcher-last-change watcher) time (watcher-changes watcher) 0))
    (if (<= (abs (- time (watcher-crowd-begins watcher))) (* 1d-7 (abs (- time start))))
        (incf (watcher-crowd watcher))
        (setf (watcher-crowd watcher) 0 (watcher-crowd-begins watcher) time))
    (if (and (< (aref (watcher-recent watcher) j) (* 1d-12 (aref (watcher-largest watcher) j))) (rates-jump-p run j))
        (incf (svref (watcher-idle watcher) j))
        (setf (svref (watcher-idle watcher) j) 0))
    (setf (aref (watcher-before watcher) j) (aref (watcher-recent watcher) j)
          (aref (watcher-recent watcher) j) 0d0)
    (> (max (watcher-changes watcher) (watcher-crowd watcher) (svref (watcher-idle watcher) j)) *most-changes*)))

(defun change-sides (run switching)
  "The run is where SWITCHING says: change modes.  Nil, or the status if it ends here."
  (let* ((watcher (run-watcher run)) (j (switching-function switching)) (time (with-control (run) (control time))))
    (cond ((>= j (watcher-known watcher)) (event-occurs run switching))
          ((accumulating-p run j time) (rest-or-lose run j))
          (t (place-state-of-watcher run)
             (if (eql 0 (svref (watcher-modes watcher) j)) (leave-surface run j) (meet-surface run j))
             (follow-jumps run)
             (note-piece run)
             nil))))

(defun place-state-of-watcher (run)
  (let ((point (watcher-point (run-watcher run))))
    (replace point (run-state run))
    (with-control (run) (setf (aref point (run-n run)) (control time)))
    point))

(defun rates-jump-p (run i)
  "Whether those on both sides of the surface I differ."
  (rate-on-side run i 1)
  (let ((above (copy-seq (watcher-rates (run-watcher run)))))
    (rate-on-side run i -1)
    (some (lambda (rate other) (> (abs (- rate other)) (* 1d-9 (max (abs rate) (abs other)))))
          above (watcher-rates (run-watcher run)))))

(defun event-occurs (run switching)
  "The function of an event has changed its sign, or has come to rest at zero: nil, or :event if the motion ends."
  (let* ((watcher (run-watcher run)) (j (switching-function switching))
         (event (svref (watcher-events watcher) (- j (watcher-known watcher))))
         (mode (if (switching-rests switching) 0 (- (svref (watcher-modes watcher) j)))))
    (setf (svref (watcher-modes watcher) j) mode)
    (when (or (zerop (event-direction event)) (= mode (event-direction event)))
      (when (= (incf (svref (watcher-occurrences watcher) j)) (event-terminal event))
        (setf (watcher-ended-by watcher) event)
        :event))))

(defun set-mode (watcher i mode)
  (setf (svref (watcher-modes watcher) i) mode
        (watcher-sliding watcher) (loop for k from 0 below (watcher-known watcher)
                                        when (eql 0 (svref (watcher-modes watcher) k)) collect k)))

(defun rate-on-side (run i mode)
  "The rate of g of the surface I where the run is, on the side MODE; and what its terms are as large as."
  (let* ((watcher (run-watcher run)) (point (place-state-of-watcher run)) (surfaces (watcher-surfaces watcher))
         (kept (svref (watcher-modes watcher) i)) (rates (watcher-rates watcher)))
    (set-mode watcher i mode)
    (put-modes watcher point)
    (funcall (the function (run-field run)) point rates)
    (incf (run-evaluations run))
    (find-values surfaces point (watcher-values watcher))
    (set-mode watcher i kept)
    (values (surface-rate surfaces i (watcher-values watcher) rates)
            (surface-rate surfaces i (map 'double-array #'abs (watcher-values watcher))
                          (map 'double-array #'abs rates)))))

(defun meet-surface (run i)
  "The run has reached the surface I: it slides if the rates of both sides lead there, turns back if it has done so
already, and else crosses it."
  (let* ((watcher (run-watcher run)) (mode (svref (watcher-modes watcher) i)))
    (multiple-value-bind (here beyond least) (rates-at-surface run i mode)
      (set-mode watcher i (cond ((and (< here least) (< beyond (- least))) 0)
                                ((and (turns-back-p run i here) (< beyond (- least))) mode)
                                (t (- mode))))
      (when (eql 0 (svref (watcher-modes watcher) i)) (put-on-surface run i)))))

(defun put-on-surface (run i &optional (part 1d-12))
  "Take from the state what roundings have left it off the surface I along which it slides, no more than PART of the
largest: what rests is to rest."
  (let* ((watcher (run-watcher run)) (surfaces (watcher-surfaces watcher)) (values (watcher-values watcher)))
    (find-values surfaces (put-modes watcher (place-state-of-watcher run)) values)
    (when (<= (abs (aref values i)) (* part (aref (watcher-largest watcher) i)))
      (move-across-surface surfaces i values (- (aref values i)) (run-state run) (run-n run)))))

(defun rates-at-surface (run i mode)
  "How fast the run leaves the surface I for the side MODE if it is there, and for the other side if it is there; and
what is rounding of these."
  (multiple-value-bind (here size) (rate-on-side run i mode)
    (multiple-value-bind (beyond other-size) (rate-on-side run i (- mode))
      (let ((direction (with-control (run) (control direction))))
        (values (* mode direction here) (* (- mode) direction beyond) (* 1d-13 (max size other-size)))))))

(defun turns-back-p (run i rate)
  "Whether RATE, at which the surface I is left, is seen in a step; and has not been found wrong before."
  (let ((watcher (run-watcher run)))
    (with-control (run)
      (and (< (watcher-changes watcher) 2)
           (> (* rate (abs (control step))) (* 1d-7 (aref (watcher-largest watcher) i)))))))

(defun leave-surface (run i)
  "The mean of the rates on both sides of the surface I has become that of one side: the run goes on there.  Along a
curved surface it has strayed by the error of its steps, and would seem to meet the surface again at once."
  (let* ((watcher (run-watcher run)) (point (put-modes watcher (place-state-of-watcher run))))
    (funcall (the function (run-field run)) point (watcher-rates watcher))
    (let ((mode (if (minusp (side-at (watcher-surfaces watcher) point i)) -1 1)))
      (put-on-surface run i 1d-3)
      (set-mode watcher i mode))))

(defun follow-jumps (run)
  "Where a g jumps because other sides have changed, its mode follows."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))))
    (dotimes (i (watcher-known watcher))
      (plain-values run (put-modes watcher (place-state-of-watcher run)) values)
      (let ((g (aref values i)))
        (when (< (* g (svref (watcher-modes watcher) i)) (* -1d-9 (aref (watcher-largest watcher) i)))
          (set-mode watcher i (round (signum g))))))))

;;; The first sides

(defun begin-watching (run)
  "The modes where the run begins: of a g that vanishes there, the side to which its rate leads; or it slides."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))) (undecided '()))
    (when (watcher-surfaces watcher)
      (dotimes (i (watcher-known watcher))
        (plain-values run (put-modes watcher (place-state-of-watcher run)) values)
        (let ((g (aref values i)))
          (set-mode watcher i (round (signum g)))
          (when (<= (abs g) (* 4d-16 (size-of-surface run i))) (push i undecided))))
      (dolist (i (reverse undecided))
        (set-mode watcher i (first-mode run i))))
    (loop for j from (watcher-known watcher) below (watched-count watcher)
          do (plain-values run (put-modes watcher (place-state-of-watcher run)) values)
             (setf (svref (watcher-modes watcher) j) (round (signum (aref values j)))))
    (note-piece run)))

(defun size-of-surface (run i)
  "What the terms of g are as large as, by its derivatives."
  (let* ((watcher (run-watcher run)) (surfaces (watcher-surfaces watcher)) (size 0d0))
    (loop for (surface . variable) in (surfaces-entries surfaces)
          for place from (surfaces-count surfaces)
          do (when (= surface i)
               (incf size (abs (* (aref (watcher-values watcher) place) (aref (watcher-point watcher) variable))))))
    size))

(defun first-mode (run i)
  "On which side of the surface I, where the run begins, it goes on: that of the rates of g; or of their own rates,
where they vanish; or on none, 0, where the rates of both sides lead back."
  (multiple-value-bind (above below) (significant-rates run i #'rate-on-side)
    (when (and (zerop above) (zerop below))
      (multiple-value-setq (above below) (significant-rates run i #'second-rate-on-side))
      (when (and (minusp above) (plusp below))
        (return-from first-mode (if (eq :undetermined (rest-or-lose run i)) 1 0))))
    (cond ((and (minusp above) (plusp below)) 0)
          ((or (plusp above) (and (zerop above) (not (minusp below)))) 1)
          (t -1))))

(defun significant-rates (run i function)
  "What FUNCTION (run i mode) says above and below the surface I, as time runs; 0 if it is rounding."
  (flet ((rate (mode)
           (multiple-value-bind (rate size) (funcall function run i mode)
             (if (<= (abs rate) (* 1d-9 size)) 0d0 (with-control (run) (* rate (control direction)))))))
    (values (rate 1) (rate -1))))

(defun second-rate-on-side (run i mode)
  "The second derivative of g on the side MODE of the surface I, roughly, along a short step of Euler's method."
  (rate-on-side run i mode)
  (let* ((watcher (run-watcher run)) (step (with-control (run) (* 1d-5 (control longest) (control direction))))
         (rates (copy-seq (watcher-rates watcher))) (state (copy-seq (run-state run))))
    (unwind-protect
         (progn
           (map-into (run-state run) (lambda (x rate) (+ x (* step rate))) state rates)
           (multiple-value-bind (rate size) (rate-on-side run i mode)
             (values (/ rate step) (/ size (abs step)))))
      (replace (run-state run) state))))

;;; Where a motion ends

(defun rest-or-lose (run i)
  "The rates on both sides of the surface I lead back to it, though they do not cross it.  If a mean of them is no
motion at all, the run rests: nil.  Else it is lost: :undetermined."
  (let* ((watcher (run-watcher run)) (n (run-n run)) (sides (list (zeros n) (zeros n))))
    (loop for mode in '(1 -1)
          for rates in sides
          do (rate-on-side run i mode)
             (replace rates (watcher-rates watcher)))
    (destructuring-bind (above below) sides
      (let* ((jump (map 'double-array #'- above below))
             (square (reduce #'+ (map 'vector #'* jump jump)))
             (share (if (zerop square) 0d0 (- (/ (reduce #'+ (map 'vector #'* below jump)) square)))))
        (cond ((and (not (problem-timed (run-problem run)))
                    (< 0 share 1)
                    (every (lambda (rate difference) (<= (abs (+ rate (* share difference))) (* 1d-9 (sqrt square))))
                           below jump))
               (set-mode watcher i 0)
               (setf (watcher-resting watcher) t)
               (note-piece run)
               nil)
              (t (setf (watcher-lost watcher) i)
                 :undetermined))))))

;;; Pieces

(defun note-piece (run)
  (let ((watcher (run-watcher run)))
    (push (cons (run-accepted run) (present-modes watcher)) (watcher-pieces watcher))
    (put-modes watcher (run-in run))))

(defun present-modes (watcher)
  "What TAKE-MODES takes: whether the run rests, and its modes."
  (cons (watcher-resting watcher) (copy-seq (watcher-modes watcher))))

(defun in-order (list) (coerce (reverse list) 'simple-vector))

(defun last-before (vector place key)
  "The place in VECTOR, ascending by KEY, of the last entry that is not beyond PLACE; -1 if there is none."
  (let ((low -1) (high (1- (length vector))))
    (loop while (< low high)
          do (let ((middle (ceiling (+ low high) 2)))
               (if (<= (funcall key (svref vector middle)) place) (setq low middle) (setq high (1- middle)))))
    low))

(defun piece-of-step (watcher place)
  "The present modes of the step at PLACE of a run that has ended."
  (let ((pieces (watcher-pieces watcher))) (cdr (svref pieces (last-before pieces place #'car)))))

(defun take-modes (watcher present-modes)
  (destructuring-bind (resting . modes) present-modes
    (replace (watcher-modes watcher) modes)
    (setf (watcher-resting watcher) resting
          (watcher-sliding watcher) (loop for k from 0 below (watcher-known watcher)
                                          when (eql 0 (svref modes k)) collect k))))

(defun take-piece (run modes)
  "Go on with MODES."
  (take-modes (run-watcher run) modes)
  (put-modes (run-watcher run) (run-in run)))

(defun sides-along (run times)
  "A function that notes in a point like the input of the field the sides at its time."
  (let* ((watcher (run-watcher run)) (pieces (watcher-pieces watcher))
         (starts (map 'double-array (lambda (piece) (aref (the double-array times) (car piece))) pieces))
         (ends (concatenate 'double-array starts (list (aref (the double-array times) (1- (length times))))))
         (rates (zeros (run-n run))))
    (when (watcher-surfaces watcher)
      (lambda (point)
        (let ((modes (cdr (svref pieces (step-place ends (aref point (run-n run)))))))
          (take-modes watcher modes)
          (put-modes watcher point)
          (when (watcher-sliding watcher) (funcall (the function (run-field run)) point rates))
          point)))))

(defun undetermined-sentence (run time)
  (let* ((watcher (run-watcher run)) (problem (run-problem run)))
    (format nil "the motion cannot be followed beyond time ~a: the equations on both sides of ~a = 0 lead back to it ~
                 again and again"
            time (maxima-text (nth (watcher-lost watcher) (surfaces-shown (problem-surfaces problem)))))))
