;;; anmech: surfaces that a motion grazes, and what its error then leaves in doubt.
;;;
;;; Where a motion turns next to a surface on which its rates jump, its error decides whether it gets across, and for
;;; how long: g is d + b s^2/2 around the time when it is extreme, so an error e of g makes 2 sqrt(2 (e - d)/b) of the
;;; time spent beyond.  That goes with the root of the error, and two integrations which miss the surface, both, agree
;;; on it to all digits; so do two which spend about as long beyond.  Where the rates of the other side lead to this
;;; one, as where a motion leaves a surface that it has slid along, it is only the error that counts.
;;;
;;; Entry points: the structure GRAZE; MAKE-GRAZE, DOUBTS-OF-GRAZE.

(in-package :anmech)
(needs "arithmetic/floats")

(defstruct graze
  time
  (depth 0d0 :type double-float)   ; how far from zero g is when it is extreme
  (bend 0d0 :type double-float)    ; its second derivative by time there, the size
  beyond                           ; whether the motion has come across, and turns there
  (back 0d0 :type double-float)    ; how fast the rates on the other side lead to this one, or 0
  slopes                           ; pairs of the place of a variable and the size of the derivative of g
  (jumps nil :type double-array))  ; by how much each rate differs on both sides

(defparameter *error-of-states* 10
  "So many times the difference of two integrations, the states may err at that time: within steps, by chance.")
(defparameter *rounding-of-states* 1d-15 "And by this part, at least.")

(defun doubts-of-graze (graze state other)
  "Of each state, by how much GRAZE leaves it in doubt, where STATE and OTHER are those of two integrations then."
  (declare (type double-array state other))
  (let* ((n (length state))
         (error (loop for (variable . slope) in (graze-slopes graze)
                      sum (* slope
                             (if (< variable n)
                                 (+ (* *error-of-states* (abs (- (aref state variable) (aref other variable))))
                                    (* *rounding-of-states* (abs (aref state variable))))
                                 (* 2.3d-16 (abs (graze-time graze)))))))
         (way (time-in-doubt graze error)))
    (declare (double-float way))
    (map-doubles ((jump (graze-jumps graze))) (* way jump))))

(defun time-in-doubt (graze error)
  "By how much the time beyond may be off, where g has an ERROR."
  (flet ((root-time (size) (* 2 (sqrt (/ (* 2 size) (graze-bend graze))))))
    (let* ((depth (graze-depth graze)) (back (graze-back graze))
           (turning (if (graze-beyond graze)
                        (- (root-time depth) (root-time (max 0d0 (- depth error))))
                        (root-time (max 0d0 (- error depth))))))
      (if (plusp back) (min turning (/ (* 2 error) back)) turning))))
