;;; anmech: surfaces that a motion grazes, and what its error then leaves in doubt.
;;;
;;; Where a motion turns next to a surface on which its rates jump, its error decides whether it gets across, and for
;;; how long: g is d + b s^2/2 around the time when it is extreme, so an error e of g makes 2 sqrt(2 (e - d)/b) of the
;;; time spent beyond.  That goes with the root of the error, and two integrations which miss the surface, both, agree
;;; on it to all digits; so do two which spend about as long beyond.  Where the rates of the other side lead to this
;;; one, as where a motion leaves a surface that it has slid along, it is only the error that counts.
;;;
;;; Entry points: the structure GRAZE; NOTE-GRAZES, DOUBTS-OF-GRAZE.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/integration" "numerics/surfaces" "numerics/watching")

(defstruct graze
  time
  (depth 0d0 :type double-float)   ; how far from zero g is when it is extreme
  (bend 0d0 :type double-float)    ; its second derivative by time there, the size
  beyond                           ; whether the motion has come across, and turns there
  (back 0d0 :type double-float)    ; how fast the rates on the other side lead to this one, or 0
  (noise 0d0 :type double-float)   ; what rounding makes of g itself
  slopes                           ; pairs of the place of a variable and the size of the derivative of g
  (jumps nil :type double-array))  ; by how much each rate differs on both sides

;;; What is noted on the way

(defparameter *rounding-of-g* 1d-15 "The part of the largest g.")
(defparameter *near-zero* 1d-4
  "An extreme value of g may be due to errors if it is this part of the largest.")

(defun note-grazes (run j value dense times values)
  "Keep where g of the surface J, with VALUES at TIMES of a step, has an extreme next to zero: on this side, or beyond,
as a step sees it that comes across, and as the piece beyond sees it from there."
  (let* ((watcher (run-watcher run)) (largest (aref (watcher-largest watcher) j)) (noise (* 1d-12 largest)))
    (when (< (reduce #'min values :key #'abs) (* 0.1d0 largest))
      (loop for (time . bend) in (extremes times values noise)
            do (let* ((time (refined-extreme value time times noise)) (extreme (funcall value time))
                      (across (< extreme (- (rounding-of watcher j)))))
                 (unless (or (> (abs extreme) (* *near-zero* largest))
                             (and across (minusp bend))
                             (and (= time (first times)) (piece-begins-p run)))
                   (let ((graze (graze-at run j dense time (if across (- extreme) (max 0d0 extreme)) bend across)))
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

(defun graze-at (run j dense time depth bend across)
  "The structure, where g has the size DEPTH at TIME, ACROSS the surface J or not; nil where the rates do not jump."
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
          (let ((jumps (map-doubles ((a above) (b below)) (abs (- a b))))
                (side (* (svref (watcher-modes watcher) j) (if across -1 1))))
            (and (some #'plusp jumps)
                 (make-graze :time time :depth depth :bend (abs bend) :beyond (or across (minusp bend)) :jumps jumps
                             :back (max 0d0 (with-control (run)
                                              (* side (control direction)
                                                 (surface-rate surfaces j values (if (plusp side) below above)))))
                             :noise (* *rounding-of-g* (aref (watcher-largest watcher) j))
                             :slopes (loop for (surface . variable) in (surfaces-entries surfaces)
                                           for place from (surfaces-count surfaces)
                                           when (= surface j) collect (cons variable (abs (aref values place))))))))
      ((or domain-violation arithmetic-error) () nil))))

;;; What is left in doubt

(defparameter *error-of-states* 10
  "So many times the difference of two integrations, the states may err at that time: within steps, by chance.")
(defparameter *rounding-of-states* 1d-15 "And by this part, at least.")

(defun doubts-of-graze (graze state other)
  "Of each state, by how much GRAZE leaves it in doubt, where STATE and OTHER are those of two integrations then."
  (declare (type double-array state other))
  (let* ((n (length state))
         (error (+ (graze-noise graze)
                   (loop for (variable . slope) in (graze-slopes graze)
                         sum (* slope
                                (if (< variable n)
                                    (+ (* *error-of-states* (abs (- (aref state variable) (aref other variable))))
                                       (* *rounding-of-states* (abs (aref state variable))))
                                    (* 2.3d-16 (abs (graze-time graze))))))))
         (way (time-in-doubt graze error)))
    (declare (double-float way))
    (map-doubles ((jump (graze-jumps graze))) (* way jump))))

(defun time-in-doubt (graze error)
  "By how much the time beyond may be off, where g has an ERROR."
  (flet ((root-time (size) (* 2 (sqrt (/ (* 2 size) (graze-bend graze))))))
    (let* ((depth (graze-depth graze)) (back (graze-back graze))
           (turning (if (graze-beyond graze)
                        (- (root-time (+ depth error)) (root-time (max 0d0 (- depth error))))
                        (root-time (max 0d0 (- error depth))))))
      (if (plusp back) (min turning (/ (* 2 error) back)) turning))))
