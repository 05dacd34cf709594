;;; anmech: a zero of a function of one variable, between two places where its signs differ; where it comes near to
;;; zero; and where it has values at all.
;;;
;;; Entry points: ENCLOSED-ZERO, PLACE-BELOW, LAST-PLACE, STRETCHES, *FADED*.
;;;
;;; Literature: M. Dowell, P. Jarratt, A modified regula falsi method for computing the root of an equation, BIT 11
;;; (1971) 168 (the secant that never leaves its interval); R. P. Brent, Algorithms for Minimization without Derivatives
;;; (1973), chapter 5 (the golden section).

(in-package :anmech)

(defun enclosed-zero (function low high at-low at-high)
  "A time at which FUNCTION vanishes, to rounding: AT-LOW and AT-HIGH, its values at LOW and HIGH, have different signs.
By secants of which the older end counts less and less, and by halves where these are slow."
  (loop for turn from 1 to 300
        do (let* ((width (abs (- high low)))
                  (middle (cond ((zerop (mod turn 4)) (/ (+ low high) 2))
                                (t (- high (* (/ at-high (- at-high at-low)) (- high low)))))))
             (unless (< (min low high) middle (max low high)) (setq middle (/ (+ low high) 2)))
             (when (or (<= width (* 2.3d-16 (max (abs low) (abs high)))) (= middle low) (= middle high))
               (return))
             (let ((value (funcall function middle)))
               (cond ((zerop value) (return-from enclosed-zero middle))
                     ((eq (plusp value) (plusp at-high))
                      (setq high middle at-high value at-low (* 0.5d0 at-low)))
                     (t (setq low high at-low at-high high middle at-high value))))))
  (if (< (abs at-high) (abs at-low)) high low))

(defconstant +golden+ 0.3819660112501051d0 "The smaller part of the golden section.")

(defun place-below (level function low high)
  "A place between LOW and HIGH where FUNCTION, which has one minimum between, is below LEVEL; nil if there is none."
  (let* ((left (+ low (* +golden+ (- high low)))) (right (- high (* +golden+ (- high low))))
         (at-left (funcall function left)) (at-right (funcall function right)))
    (loop repeat 40
          do (cond ((< at-left level) (return left))
                   ((< at-right level) (return right))
                   ((< at-left at-right)
                    (setq high right right left at-right at-left
                          left (+ low (* +golden+ (- high low)))
                          at-left (funcall function left)))
                   (t
                    (setq low left left right at-left at-right
                          right (- high (* +golden+ (- high low)))
                          at-right (funcall function right)))))))

(defun last-place (predicate inside outside)
  "The last place from INSIDE, where PREDICATE holds, to OUTSIDE, where it does not: neighbours in the end."
  (declare (type function predicate))
  (loop repeat 200
        do (let ((middle (/ (+ inside outside) 2)))
             (cond ((or (= middle inside) (= middle outside)) (return))
                   ((funcall predicate middle) (setq inside middle))
                   (t (setq outside middle)))))
  inside)

(defun stretches (has-value-p places)
  "PLACES as lists of those between which there are values, each with the last ones before and after which there are
none; if there are values everywhere, one list."
  (let ((found '()) (stretch '()) (before nil))
    (flet ((end-stretch () (when stretch (push (nreverse stretch) found) (setq stretch '()))))
      (loop for place in places
            for here = (funcall has-value-p place)
            do (cond ((and here before (null stretch))
                      (setq stretch (list place))
                      (let ((edge (last-place has-value-p place before)))
                        (unless (= edge place) (setq stretch (list place edge)))))
                     (here (push place stretch))
                     (stretch
                      (let ((edge (last-place has-value-p (first stretch) place)))
                        (unless (= edge (first stretch)) (push edge stretch)))
                      (end-stretch)))
               (setq before place))
      (end-stretch)
      (nreverse found))))

(defparameter *faded* 1d-200 "What is below this on the way to zero fades: it will be too small for a double.")
