;;; anmech: the functions that go with a run whose field has kinks, or in which events are looked for.
;;;
;;; A *watcher* goes with a run.  It has a number of functions of time and state: first the g of the surfaces where the
;;; field has kinks (surfaces.lisp), then those of events.  Each has a *mode*, the sign that it has at present; where a
;;; function times its mode becomes negative, sides change (switching.lisp).
;;;
;;; Where the rates of both sides lead to a surface, the motion *slides* along it: the mode is 0, and the rates are
;;; A. F. Filippov's, the mean of those of both sides that is tangent to the surface; on several surfaces at once the
;;; signs are those that keep all g at zero (the equivalent control of V. I. Utkin), which is the same where the rates
;;; are linear in the signs, as in dry friction.  It leaves the surface where the mean becomes one of both.  Then the
;;; function that is watched is 4 w v, which is positive as long as both have a share.
;;;
;;; Entry points: the structure WATCHER with its slots; NEW-WATCHER, WATCHED-COUNT, WATCHED-FIELD, PUT-MODES,
;;; PLAIN-VALUES, WATCHED-VALUES, HAS-VALUE-P, POINT-OF-STEP, POINT-AT-END, ROUNDING-OF, PIECE-BEGINS-P.
;;;
;;; Literature: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (1988); V. I. Utkin, Sliding
;;; Modes in Control and Optimization (1992); L. Dieci, L. Lopez, Sliding motion in Filippov differential systems,
;;; SIAM J. Numer. Anal. 47 (2009) 2023.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/linear" "numerics/integration" "numerics/surfaces")

(defstruct watcher
  surfaces                       ; or nil
  (known 0 :type fixnum)         ; how many surfaces
  (events #() :type simple-vector)
  (modes #() :type simple-vector)      ; signs; of a surface 0 while the motion slides along it, of an event before the
                                       ; first sign is seen
  (largest nil :type double-array)     ; of each function, the largest size so far
  (recent nil :type double-array)      ; the same since its last change
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
  lost                           ; the surface at which the motion was lost, and what its sides' equations do there
  ended-by)                      ; the event that has ended it

(defun watched-count (watcher) (+ (watcher-known watcher) (length (watcher-events watcher))))

(defun new-watcher (problem)
  "Of the surfaces and events of PROBLEM; nil if it has none."
  (let* ((surfaces (problem-surfaces problem)) (events (coerce (problem-events problem) 'simple-vector))
         (known (if surfaces (surfaces-count surfaces) 0)) (count (+ known (length events))) (n (problem-n problem)))
    (when (plusp count)
      (make-watcher :surfaces surfaces :known known :events events
                    :modes (make-array count :initial-element 0) :occurrences (make-array count :initial-element 0)
                    :largest (zeros count) :recent (zeros count) :idle (make-array count :initial-element 0)
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

(defun rounding-of (watcher j) (* 1d-14 (aref (watcher-largest watcher) j)))

(defun piece-begins-p (run) (eql (run-accepted run) (or (first (run-beginnings run)) 0)))
