;;; anmech: where the sides of a motion change, and what is looked for on the way.
;;;
;;; Each step that was good is searched for the first place where a function of its watcher (watching.lisp) times its
;;; mode becomes negative.  Where a step begins, after a change, that may be so by roundings: it counts only if the same
;;; is found soon after.  When g reaches zero and the rates beyond lead on, its mode changes; when they lead back, the
;;; motion slides.
;;;
;;; A step is searched at seven places.  A function that it does not follow (a cubic through four of them misses the
;;; others) may vanish anywhere in it: then the step is unresolved, and a shorter one is taken.  What is as good as zero
;;; is told by the sizes of a function along the motion, not by those that a long step sees beyond a switching.
;;;
;;; Entry points: FIRST-SWITCHING, AT-ONCE-P, the structure SWITCHING, WATCHED-AT-END, CHANGE-SIDES, BEGIN-WATCHING,
;;; IN-ORDER, LAST-BEFORE, PIECE-OF-STEP, PRESENT-MODES, TAKE-PIECE, SIDES-ALONG, SIDE-CHANGES-BY-P,
;;; UNDETERMINED-SENTENCE.
;;;
;;; Literature: L. F. Shampine, S. Thompson, Comput. Math. Appl. 39 (2000) 43.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/grazing" "numerics/integration" "numerics/surfaces"
       "numerics/watching" "numerics/zeros")

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

(defun at-once-p (run time)
  "Whether TIME is that where the run is, to rounding: what changes at TIME changes here."
  (with-control (run) (<= (abs (- time (control time))) (* 4.5d-16 (abs (control time))))))

(defun places-in-step (run)
  "Seven times, equidistant; where the step is as short as times are rounded, those that are not at once: after a change
here they may still be on the side that was left."
  (with-control (run)
    (let* ((start (control time)) (step (control step)) (end (flo (+ start step))))
      (declare (double-float start step end))
      (cons start
            (remove-if (lambda (time) (at-once-p run time))
                       (loop for k from 1 to 6 collect (if (= k 6) end (+ start (* k (/ step 6d0))))))))))

(defun first-switching (run dense)
  "The first switching in a step that was completed, :unresolved, or nil; if it ends at once, the next one will tell."
  (let ((times (places-in-step run)) (watcher (run-watcher run)))
    (when (rest times)
      (let* ((largest (copy-seq (watcher-largest watcher))) (recent (copy-seq (watcher-recent watcher)))
             (found (first-switching-at run dense times)))
        (when found
          (replace (watcher-largest watcher) largest)
          (replace (watcher-recent watcher) recent)
          (note-sizes-until run dense (if (eq found :unresolved) (first times) (switching-time found))))
        found))))

(defun note-sizes-until (run dense time)
  "Those of all functions from the beginning of the step up to TIME, where it is going to end: what a long step sees
beyond is no part of the motion, and may be larger by many powers of ten; beside that, all would be rounding."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher)))
         (start (with-control (run) (control time))))
    (put-modes watcher (watcher-point watcher))
    (dolist (part '(0d0 0.25d0 0.5d0 0.75d0 1d0))
      (watched-values run (point-of-step run dense (+ start (* part (- time start)))) values)
      (dotimes (j (length values))
        (when (has-value-p (aref values j)) (note-largest watcher j (list (aref values j))))))))

(defun first-switching-at (run dense times)
  "The same, looked for at TIMES."
  (let* ((watcher (run-watcher run)) (count (watched-count watcher)) (first nil) (unresolved nil))
    (put-modes watcher (watcher-point watcher))
    (with-control (run)
      (let* ((long (> (abs (control step)) (* 1d-9 (abs (- (control end) (control start))))))
             (rows (mapcar (lambda (time)
                             (copy-seq (watched-values run (point-of-step run dense time) (zeros count))))
                           times)))
        (flet ((value (j) (lambda (time)
                            (aref (watched-values run (point-of-step run dense time) (zeros count)) j))))
          (dotimes (j count)
            (note-first-sign run j dense times rows)
            (multiple-value-bind (times values)
                (where-it-is run j (value j) times (mapcar (lambda (row) (aref row j)) rows))
              (note-largest watcher j (subseq values 0 (position-if #'minusp values)))
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

(defun back-at-once-p (watcher j zero times values)
  "Whether the surface J, which would be met at the time ZERO, where the step begins, is left later in the step.  It may
be that it is left along a tangent, and that what a method sees of the motion within a long step is less accurate than
that."
  (and (< j (watcher-known watcher)) (= zero (first times)) (> (reduce #'max values) (rounding-of watcher j))))

(defun side-changes-by-p (run dense time)
  "Whether the side of a surface has changed at TIME, a little beyond the step, as the step seems to go on; as where
sides are changed, by more than rounding: a surface that is hardly left, or not at all, seems to be met in all steps."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))))
    (put-modes watcher (watcher-point watcher))
    (watched-values run (point-of-step run dense time) values)
    (loop for j below (watcher-known watcher) thereis (< (aref values j) (- (rounding-of watcher j))))))

(defun sooner-p (run time other)
  (with-control (run) (plusp (* (control direction) (- other time)))))

(defun looked-for-p (watcher j)
  "Whether a step must end where the function J vanishes; not so for events that end nothing."
  (or (< j (watcher-known watcher)) (event-terminal (svref (watcher-events watcher) (- j (watcher-known watcher))))))

(defun note-largest (watcher j values)
  (dolist (value values)
    (setf (aref (watcher-largest watcher) j) (max (aref (watcher-largest watcher) j) (abs value))
          (aref (watcher-recent watcher) j) (max (aref (watcher-recent watcher) j) (abs value)))))

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
    (setf (aref (watcher-recent watcher) j) 0d0)
    (> (max (watcher-changes watcher) (watcher-crowd watcher) (svref (watcher-idle watcher) j)) *most-changes*)))

(defun change-sides (run switching)
  "The run is where SWITCHING says: change modes.  Nil, or the status if it ends here."
  (let* ((watcher (run-watcher run)) (j (switching-function switching)) (time (with-control (run) (control time))))
    (cond ((>= j (watcher-known watcher)) (event-occurs run switching))
          ((accumulating-p run j time) (rest-or-lose run j))
          (t (place-state-of-watcher run)
             (if (eql 0 (svref (watcher-modes watcher) j)) (leave-surface run j) (meet-surface run j))
             (follow-jumps run j)
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
    (unwind-protect
         (progn
           (set-mode watcher i mode)
           (put-modes watcher point)
           (funcall (the function (run-field run)) point rates)
           (incf (run-evaluations run))
           (find-values surfaces point (watcher-values watcher)))
      (set-mode watcher i kept))
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
      (when (surfaces-bounded (watcher-surfaces (run-watcher run))) (look-beyond run i (- mode)))
      (let ((direction (with-control (run) (control direction))))
        (values (* mode direction here) (* (- mode) direction beyond) (* 1d-13 (max size other-size)))))))

(defparameter *just-beyond* 1d-9 "By so much of the largest g.")

(defun look-beyond (run i mode)
  "Call the field a little beyond the surface I, on the side MODE, whose slopes have just been found: a root of what
jumps and is negative there has a value on the surface, where it is taken of 0, and none beyond.  Conditions of the
field pass through."
  (let* ((watcher (run-watcher run)) (surfaces (watcher-surfaces watcher)) (values (watcher-values watcher))
         (n (run-n run)) (point (put-modes watcher (place-state-of-watcher run)))
         (way (* mode *just-beyond* (aref (watcher-largest watcher) i))))
    (put-side surfaces point i mode)
    (move-across-surface surfaces i values way point n)
    (let ((slope (slope-of-time-alone surfaces i values n)))
      (when slope (incf (aref point n) (/ way slope))))
    (funcall (the function (run-field run)) point (watcher-rates watcher))
    (incf (run-evaluations run))))

(defun slope-of-time-alone (surfaces i values n)
  "The derivative by the time, the variable N, of g of the surface I, if that depends on nothing else; else nil."
  (let ((slopes (loop for (surface . variable) in (surfaces-entries surfaces)
                      for place from (surfaces-count surfaces)
                      when (= surface i) collect (cons variable (aref values place)))))
    (and (equal (mapcar #'car slopes) (list n))
         (/= (cdr (first slopes)) 0)
         (cdr (first slopes)))))

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

(defun follow-jumps (run changed)
  "Where a g jumps because the side of the surface CHANGED is another, its mode follows.  That surface itself is where
the run is, as near as times are doubles."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))))
    (dotimes (i (watcher-known watcher))
      (plain-values run (put-modes watcher (place-state-of-watcher run)) values)
      (let ((g (aref values i)))
        (when (and (/= i changed)
                   (< (* g (svref (watcher-modes watcher) i)) (* -1d-9 (aref (watcher-largest watcher) i))))
          (set-mode watcher i (round (signum g))))))))

;;; The first sides

(defparameter *part-of-terms* 4d-2
  "Of the terms of g, as a size of g: beside that, their rounding is what is as good as zero (ROUNDING-OF).")

(defun begin-watching (run)
  "The modes where the run begins: of a g that vanishes there, the side to which its rate leads; or it slides."
  (let* ((watcher (run-watcher run)) (values (zeros (watched-count watcher))) (undecided '()))
    (when (watcher-surfaces watcher)
      (dotimes (i (watcher-known watcher))
        (plain-values run (put-modes watcher (place-state-of-watcher run)) values)
        (let ((g (aref values i)) (size (size-of-surface run i)))
          (set-mode watcher i (round (signum g)))
          (setf (aref (watcher-largest watcher) i) (* *part-of-terms* size))
          (when (<= (abs g) (* 4d-16 size)) (push i undecided))))
      (dolist (i (reverse undecided))
        (set-mode watcher i (first-mode run i)))
      (let ((i (find-if (lambda (i) (either-way-p run i undecided)) undecided)))
        (when i (setf (watcher-lost watcher) (cons i "lead away from it")))))
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
  (multiple-value-bind (above below second) (leading-rates run i)
    (cond ((and (minusp above) (plusp below))
           (if (and second (eq :undetermined (rest-or-lose run i))) 1 0))
          ((or (plusp above) (and (zerop above) (not (minusp below)))) 1)
          (t -1))))

(defun leading-rates (run i)
  "The significant rates above and below the surface I, or, where both vanish, their own; and whether it is these."
  (multiple-value-bind (above below) (significant-rates run i #'rate-on-side)
    (if (and (zerop above) (zerop below))
        (multiple-value-bind (above below) (significant-rates run i #'second-rate-on-side)
          (values above below t))
        (values above below nil))))

(defun either-way-p (run i undecided)
  "Whether the motion might as well begin on the other side of the surface I as where it does, since both lead away, and
the modes of the others of UNDECIDED would be what they are."
  (let* ((watcher (run-watcher run)) (mode (svref (watcher-modes watcher) i)))
    (flet ((stays-p (k)
             (multiple-value-bind (above below) (leading-rates run k)
               (case (svref (watcher-modes watcher) k)
                 (1 (not (minusp above)))
                 (-1 (not (plusp below)))
                 (t (and (minusp above) (plusp below)))))))
      (multiple-value-bind (above below) (leading-rates run i)
        (when (and (plusp above) (minusp below))
          (set-mode watcher i (- mode))
          (unwind-protect (every #'stays-p (remove i undecided))
            (set-mode watcher i mode)))))))

(defun significant-rates (run i function)
  "What FUNCTION (run i mode) says above and below the surface I, as time runs; 0 if it is rounding."
  (flet ((rate (mode)
           (multiple-value-bind (rate size) (funcall function run i mode)
             (if (<= (abs rate) (* 1d-9 size)) 0d0 (with-control (run) (* rate (control direction)))))))
    (values (rate 1) (rate -1))))

(defun second-rate-on-side (run i mode)
  "The second derivative of g on the side MODE of the surface I, roughly, along a short step of Euler's method."
  (rate-on-side run i mode)
  (with-control (run)
    (let* ((watcher (run-watcher run)) (step (* 1d-5 (control longest) (control direction))) (time (control time))
           (rates (copy-seq (watcher-rates watcher))) (state (copy-seq (run-state run))))
      (unwind-protect
           (progn
             (map-into (run-state run) (lambda (x rate) (+ x (* step rate))) state rates)
             (setf (control time) (+ time step))
             (multiple-value-bind (rate size) (rate-on-side run i mode)
               (values (/ rate step) (/ size (abs step)))))
        (setf (control time) time)
        (replace (run-state run) state)))))

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
              (t (setf (watcher-lost watcher) (cons i "lead back to it again and again"))
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
  (destructuring-bind (i . what-they-do) (watcher-lost (run-watcher run))
    (format nil "the motion cannot be followed beyond time ~a: the equations on both sides of ~a = 0 ~a"
            time (maxima-text (nth i (surfaces-shown (problem-surfaces (run-problem run))))) what-they-do)))
