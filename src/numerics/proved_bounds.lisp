;;; anmech: what is read of an enclosed motion: bounds of states, and of expressions in them, at any time.
;;;
;;; Expressions are computed with the balls of states, time, parameters and, where they hold any, of unknowns; bounds
;;; are the doubles next to the ends of these balls on the outer sides.
;;;
;;; Entry points: DOUBLE-BELOW, DOUBLE-ABOVE; $anmech_is_enclosed, $anmech_times_inside, $anmech_exact_samples,
;;; $anmech_proved_bounds, $anmech_note_enclosure.

(in-package :anmech)
(needs "session/texts" "algebra/terms" "numerics/ball_functions" "numerics/balls" "numerics/codegen" "numerics/dag"
       "numerics/doubles" "numerics/enclosed_motion" "numerics/evaluation" "numerics/lohner" "numerics/model"
       "numerics/motion" "numerics/motion_reading" "numerics/sharing" "numerics/solved_program")

(defparameter *smallest-places* 1000 "Bounds are multiples of two to minus that, which doubles hold.")

(defun double-below (number)
  "The largest double that is not above the rational NUMBER, or one next to it."
  (let* ((number (/ (floor (* number (ash 1 *smallest-places*))) (ash 1 *smallest-places*)))
         (nearest (to-double number)))
    (if (<= (rational nearest) number) nearest (neighbour nearest number))))

(defun double-above (number) (- (double-below (- number))))

(defun bounds-of-ball (ball)
  (numbers-list (list (double-below (ball-value (ball-low ball))) (double-above (ball-value (ball-high ball))))))

(defun balls-of-point (motion reader time)
  "The inputs of READER at TIME, a number of Maxima."
  (let* ((enclosure (motion-enclosure motion)) (n (motion-dimension motion))
         (time (time-inside enclosure time))
         (inputs (concatenate 'vector (enclosed-states enclosure time) (list (ball-of time))
                              (subseq (enclosure-inputs enclosure) (1+ n)))))
    (if (value-reader-inner reader)
        (concatenate 'vector inputs (enclosed-unknowns motion inputs))
        inputs)))

(defun time-inside (enclosure given)
  "The exact time GIVEN; nothing is proved beyond the ends, however near."
  (let ((time (exact-time given)) (start (enclosure-start enclosure)) (end (enclosure-time enclosure)))
    (unless (<= (min start end) time (max start end))
      (complain "the time ~a was rounded to just outside of the interval; state it exactly" (one-line given)))
    time))

(defun solved-near (motion inputs)
  "The program of rates and unknowns whose pivots are good at INPUTS, balls."
  (let ((model (motion-model motion)))
    (if (null (model-arrangement model))
        (enclosure-solved (motion-enclosure motion))
        (values (solved-program model (map 'vector (lambda (input) (ball-value (ball-middle input))) inputs))))))

(defun enclosed-unknowns (motion inputs)
  (let* ((model (motion-model motion)) (solved (solved-near motion inputs))
         (results (nthcdr (motion-dimension motion) (program-results solved))) (program (copy-program solved)))
    (unless (= (length results) (length (model-unknowns model)))
      (complain "rigorous = true has no bounds of accelerations and multipliers of these equations"))
    (setf (program-results program) results)
    (funcall (the function (program-function program (ball-numbers))) inputs)))

(maxima::defmfun maxima::$anmech_is_enclosed (motion)
  "anmech_is_enclosed(record): whether its bounds are proved."
  (and (motion-enclosure motion) t))

(maxima::defmfun maxima::$anmech_note_enclosure (motion times rows)
  "anmech_note_enclosure(record, [time, ...], [[[lower, upper], ...], ...]): keep the bounds at the samples; the error
that is told is no less than theirs."
  (let ((enclosure (motion-enclosure motion)))
    (loop for time in (rest times)
          for row in (rest rows)
          for sizes = (sizes-until enclosure time)
          do (loop for size in sizes
                   for (nil low high) in (rest row)
                   for part = (/ (- (rational high) (rational low)) 2 size)
                   do (setf (enclosure-widest enclosure) (max part (enclosure-widest enclosure)))))
    (setf (motion-error-estimate motion) (error-of-enclosure enclosure)
          (motion-message motion) (sentence-of-enclosure enclosure))
    (maxima::$anmech_motion_note motion 'maxima::$enclosure rows)))

(defun no-double-inside-p (motion)
  "Whether nothing is enclosed but a start that is no double."
  (let* ((enclosure (motion-enclosure motion)) (start (enclosure-start enclosure)))
    (and (= start (enclosure-time enclosure)) (/= start (rational (motion-reached motion))))))

(maxima::defmfun maxima::$anmech_times_inside (motion samples)
  "anmech_times_inside(record, n or [time, ...]): as anmech_sample_times, but no time is rounded beyond the ends; where
no double is between them, the one next to the start alone."
  (let* ((start (enclosure-start (motion-enclosure motion))) (end (rational (motion-reached motion)))
         (first (double-inside start end)) (last (motion-reached motion)))
    (maxima-list
     (if (no-double-inside-p motion)
         (list last)
         (mapcar (lambda (time) (max (min first last) (min (max first last) (to-double (exact-value time)))))
                 (rest (if (consp samples)
                           (maxima::$anmech_those_within samples start end t)
                           (maxima-list (equal-parts start end samples)))))))))

(maxima::defmfun maxima::$anmech_exact_samples (motion times)
  "anmech_exact_samples(record, [time, ...]): where bounds are known of these samples, which anmech_times_inside gave."
  (if (no-double-inside-p motion)
      (maxima-list (list (from-rational (enclosure-start (motion-enclosure motion)))))
      times))

(maxima::defmfun maxima::$anmech_proved_bounds (motion reader times)
  "anmech_proved_bounds(record, reader, [time, ...]): for each time the bounds of each expression, [lower, upper]."
  (let* ((*ball-bits* (enclosure-bits (motion-enclosure motion)))
         (program (with-compilation-errors
                    (lambda ()
                      (expressions-program (value-reader-expressions reader) (value-reader-inputs reader)
                                           :round-constants nil))))
         (function (program-function program (ball-numbers))))
    (flet ((bounds-at (time)
             (mapcar #'bounds-of-ball (funcall (the function function) (balls-of-point motion reader time)))))
      (with-value-errors
        (lambda ()
          (maxima-list (loop for time in (rest times) collect (maxima-list (bounds-at time)))))))))
