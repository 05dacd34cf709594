;;; anmech: passes of integrations to a wanted accuracy: what one tells of the error, and what the next is to be.
;;;
;;; A pass is an integration, another one that checks it, with a coarser tolerance, and their difference, which is
;;; nearly the error of the other one.  Where tolerances are of the size of roundings, or motions are sensitive, a
;;; difference may be small by chance: errors then all lie along the one direction that grows, and a check that errs R
;;; times as much as the integration differs from it by less than a third of its error in 1 of 4 R motions, all along.
;;; So what passes before have seen counts, too, and where rounding governs a single difference is told three times.
;;;
;;; Entry points: the structure PASS with its slots; FIRST-PASS, PASS-AFTER, PASS-BETWEEN, JUDGE-PASS, LAST-PASS-P,
;;; BETTER-P, DOUBT-PASS, HOPELESS-P, COARSER, ROUNDING-MATTERS-P, SENSITIVE-P, FINEST-P, FALLS-AS-EXPECTED-P,
;;; FIRST-TOLERANCE, GIVEN-UP-P, OBSTACLE-P, CUT-SHORT-P, MOTION-TROUBLE, *FINE*, *FINEST*, *LEAST-APART*,
;;; *DOUBT-OF-ONE*.

(in-package :anmech)
(needs "numerics/comparison" "numerics/integration" "numerics/motion" "numerics/weights")

(defstruct pass
  tolerance check             ; of the integration that may be handed out, and of that which checks it
  weights                     ; what errors count by
  expected                    ; what the difference is to be if it falls as CHECK does since the pass before, or nil
  kept                        ; the integration, if it was that of the pass before, or nil
  ;; what was found
  motion                      ; that of the integration
  seen                        ; their difference; nil where an interruption has kept them from being compared
  better-weights
  chance                      ; whether the difference is one of chance, as it has hardly fallen
  (likely 0d0)                ; the error as what follows is planned by it
  (error 0d0))                ; and as it is claimed

;;; Tolerances

(defparameter *finest* 5d-16 "The finest tolerance that makes sense.")
(defparameter *fine* 1d-14 "A tolerance from which on rounding matters, where the check's is ten times coarser.")
(defparameter *apart* 10d0 "How much coarser a check is.")
(defparameter *least-apart* 4d0 "Near the finest possible, less is left between both.")

(defun coarser (tolerance)
  "The tolerance of the second integration."
  (* tolerance (if (<= tolerance *finest*) *least-apart* *apart*)))

(defun rounding-matters-p (check)
  "Whether it does where the second integration has the tolerance CHECK."
  (<= check (* *apart* *fine*)))

(defun finest-p (pass)
  "Whether no other one can tell more: below such a check there is but rounding."
  (and (<= (pass-tolerance pass) *finest*) (<= (pass-check pass) *fine*)))

(defun first-tolerance (accuracy)
  "Of a pass that costs little and finds how much larger the error of a motion is than that of a step."
  (max (/ accuracy 10) (min 1d-5 (expt (/ accuracy 10) 0.6d0)) *finest*))

(defparameter *aim* 0.1d0
  "The part of the wanted error that a finer tolerance is to bring: one pass more costs more than finer steps.")

(defun next-tolerance (tolerance ratio)
  "A finer tolerance, where RATIO is the wanted error by that which was found.  Near the finest, where steps cost most,
no more is aimed at than what is wanted; short of it a stop is made, unless that is clearly not enough."
  (let ((enough (* tolerance (min 0.1d0 ratio))) (aimed (* tolerance (min 0.1d0 (* *aim* ratio)))))
    (cond ((>= aimed *fine*) aimed)
          ((and (> tolerance (* 2 *fine*)) (> (* 5 enough) *fine*)) *fine*)
          ((< enough (* 5 *finest*)) *finest*)
          (t (min *fine* (* 0.7d0 enough))))))

(defun tolerance-between (too-fine tolerance)
  "One that is finer than TOLERANCE, but not as TOO-FINE; nil if these are near one another."
  (cond ((< too-fine *fine* tolerance) *fine*)
        ((< (* 100 too-fine) tolerance) (sqrt (* too-fine tolerance)))))

;;; What is to be done

(defparameter *nearly-finest* 1d-12 "Here, two digits more of a step cost a tenth of the time by series.")

(defun new-pass (tolerance check weights before steep)
  "One of these tolerances and WEIGHTS after BEFORE, or nil.  STEEP: whether errors fall so much faster than costs grow
that near the finest tolerance no other is worth an integration: then checks alone become finer."
  (let ((seen (difference-of-pass before)))
    (make-pass :tolerance tolerance :check check :weights weights
               :expected (and seen (< seen *telling*) (* seen (/ check (pass-check before))))
               :kept (and steep before (= tolerance (pass-tolerance before)) (whole-integration before)))))

(defparameter *telling* 0.1d0 "A larger error than this tells little of what a finer tolerance will bring.")

(defun difference-of-pass (pass)
  "The largest that was seen in PASS, or nil, where that is nil."
  (cond ((null pass) nil)
        ((pass-seen pass) (difference-error (pass-seen pass)))
        (t 0d0)))

(defun whole-integration (pass)
  "That of PASS, if it has come to its end."
  (let ((integration (motion-integration (pass-motion pass))))
    (and (eq :ok (integration-status integration)) integration)))

(defun first-pass (task first first-check)
  "That of the tolerance FIRST and, where that is not nil, the FIRST-CHECK: then errors are steep."
  (let ((tolerance (if (task-verify task) first (max (/ (task-accuracy task) 10) *finest*))))
    (new-pass tolerance (or first-check (coarser tolerance)) (first-weights (task-problem task)) nil first-check)))

(defun pass-after (pass accuracy steep)
  "A finer one than PASS."
  (let* ((ratio (wanted-ratio pass accuracy)) (tolerance (pass-tolerance pass))
         (next (if (and steep (<= tolerance *nearly-finest*)) *finest* (next-tolerance tolerance ratio))))
    (new-pass next
              (if (and steep (<= next *finest*)) (next-check next pass ratio) (coarser next))
              (pass-better-weights pass) pass steep)))

(defun next-check (tolerance pass ratio)
  "The tolerance of a check of the finest TOLERANCE, after that of PASS, RATIO as above; one that would nearly be the
last is the last."
  (let ((next (* (pass-check pass) (min 0.1d0 (* *aim* ratio)))))
    (max (* *least-apart* tolerance)
         (if (< next (* 2 *fine*)) (min next *fine*) next))))

(defun pass-between (too-fine before steep)
  "One that is finer than BEFORE, but not TOO-FINE; nil if these are near one another."
  (let ((tolerance (tolerance-between (pass-tolerance too-fine) (pass-tolerance before))))
    (and tolerance (new-pass tolerance (coarser tolerance) (pass-weights too-fine) before steep))))

(defparameter *told* 0.3d0
  "A smaller part of the tolerance, as an error, is due to the few steps that it was found in: it does not tell what
finer ones make.")

(defun told-error (pass accuracy)
  "What the error tells of finer tolerances: where they would meet with rounding, no more is taken than is necessary."
  (if (clear-of-noise-p accuracy (pass-weights pass)
                        (integration-largest (motion-integration (pass-motion pass))))
      (max (pass-likely pass) (* *told* (pass-tolerance pass)))
      (pass-likely pass)))

(defparameter *usual-ratio* 2.5d-5 "What the next tolerance is finer by where an error tells nothing.")

(defun wanted-ratio (pass accuracy)
  "The wanted error by that which was found; near obstacles, where that tells nothing, a usual one."
  (let* ((motion (pass-motion pass)) (seen (pass-seen pass)) (error (max (told-error pass accuracy) 1d-300)))
    (cond ((cut-short-p motion) *usual-ratio*)
          ((obstacle-p (motion-integration motion)) (max *usual-ratio* (/ accuracy error)))
          (t (/ accuracy (max error (if seen (error-to-come seen (motion-integration motion)) 0d0)))))))

(defun error-to-come (seen integration)
  "What the difference would be if it were not bounded by the sizes of the states: from where it was small it has grown
like the square of time, as a phase does whose rate drifts."
  (let ((error (difference-error seen))
        (small (find-if (lambda (rise) (<= (cdr rise) (* 0.1d0 *telling*))) (difference-rises seen)))
        (way (abs (- (integration-time integration) (integration-start integration)))))
    (if (and small (> error *telling*) (/= (car small) (integration-start integration)))
        (max error (* (cdr small) (expt (/ way (abs (- (car small) (integration-start integration)))) 2)))
        error)))

;;; How motions end

(defun given-up-p (integration)
  "Whether it could go on."
  (member (integration-status integration) '(:interrupted :too-many-steps :stiff :crawling)))

(defun obstacle-p (integration)
  "Whether it ends early because it cannot go on."
  (and (integration-message integration) (not (given-up-p integration))))

(defun cut-short-p (motion)
  (/= (motion-reached motion) (integration-time (motion-integration motion))))

(defun motion-trouble (motion)
  "The sentence that says why it ends early, or nil."
  (integration-message (motion-integration motion)))

(defun unfinished-p (motion) (given-up-p (motion-integration motion)))

;;; What it tells

(defparameter *coarse* 3d-6
  "Where no more is asked for, steps are few, and as long in both integrations where kinks or stability bound them: the
finer one errs by more than a tenth of the difference.")

(defparameter *doubt-of-one* 3
  "Where rounding governs, one difference may be small by chance: so many times that is told.")

(defun judge-pass (pass before accuracy)
  "Note what is to be said of the error, after the pass BEFORE, or nil."
  (let* ((seen (pass-seen pass)) (difference (difference-of-pass pass)) (expected (pass-expected pass)))
    (setf (pass-chance pass) (or (stalled-p pass before)
                                 (and before (pass-chance before) seen (not (falls-as-expected-p seen expected))))
          (pass-likely pass) (* difference (cond ((or (pass-chance pass) (rounding-limited-p pass)) 3)
                                                 ((and seen (difference-alone seen)) *doubt-of-one*)
                                                 ((>= accuracy *coarse*) 2)
                                                 (t 1)))
          (pass-error pass) (max (pass-likely pass)
                                 (if (chances-are-few-p pass) (* *doubt-of-one* difference) 0d0)
                                 (if (and expected (sensitive-p expected pass)) (/ expected 3) 0d0)))
    pass))

(defun chances-are-few-p (pass)
  "Whether rounding alone makes the integrations of PASS differ, each of which is new, and the motion makes very much of
it: then one of a hundred pairs of differences is less than a third of the error."
  (and (finest-p pass)
       (null (pass-kept pass))
       (sensitive-p (difference-of-pass pass) pass *unbounded*)))

(defun rounding-limited-p (pass)
  "Whether the difference has not fallen as the tolerance has: then rounding governs it."
  (let ((expected (pass-expected pass)))
    (and expected (rounding-matters-p (pass-check pass)) (> (difference-of-pass pass) (* 2 expected)))))

(defun falls-as-expected-p (seen expected)
  "Whether the difference is what a tolerance so much finer makes of that of the pass before, by its power: where
rounding governs it is one of chance, and two are better than one."
  (and expected (<= (difference-error seen) (* 2 expected))))

(defun stalled-p (pass before)
  "Whether a difference has hardly fallen with the tolerance, which has by ten at least: it is one of chance; where the
field depends on time the rounding of late times governs it; but one of the size of the motion itself tells nothing, nor
does one below the tolerance, which a few steps that are as long as they can be make."
  (let ((difference (difference-of-pass pass)) (previous (difference-of-pass before)))
    (and previous (< difference 1d-3) (< (* 0.3d0 previous) difference) (< (pass-check pass) difference))))

(defparameter *sensitive* 3 "A motion may be, that makes so much more of an error than its check's tolerance.")
(defparameter *very-sensitive* 30 "And surely is, that makes so much more.")
(defparameter *unbounded* 10000 "Of so much, nothing but the end of the motion bounds what it makes.")

(defun sensitive-p (difference pass &optional (by *sensitive*))
  "Whether one of that size would be due to what has grown most; what rounding makes counts as a tolerance does."
  (> difference (* by (max *fine* (pass-check pass)))))

;;; Which one is the last, and which the best

(defun last-pass-p (pass before accuracy timed)
  "TIMED: whether the field depends on time."
  (let ((motion (pass-motion pass)) (difference (difference-of-pass pass)) (previous (difference-of-pass before))
        (rounding (rounding-matters-p (pass-check pass))))
    (cond ((finest-p pass) t)
          ((eq :crawling (integration-status (motion-integration motion))) nil)
          ((obstacle-p (motion-integration motion)) (or rounding (and before (same-obstacle-p pass before))))
          ((and (cut-short-p motion) (not (unfinished-p motion))) nil)    ; a finer check may come further
          (t (or (<= (pass-error pass) accuracy)
                 (and previous rounding (< (* 0.5d0 previous) difference))
                 ;; once may be luck of the coarser of few steps
                 (and timed before (pass-chance before) (stalled-p pass before)))))))

(defun same-obstacle-p (pass before)
  "Whether a motion ends where the one before did, and is good nearly up to there."
  (let* ((end (motion-reached (pass-motion pass)))
         (way (abs (- end (integration-start (motion-integration (pass-motion pass)))))))
    (and (<= (abs (- end (motion-reached (pass-motion before)))) (* 1d-5 way))
         (<= (abs (- end (difference-good-until (pass-seen pass)))) (* 1d-4 way)))))

(defun better-p (pass best)
  "Whether a later motion is to be preferred: it is the finer one; only where rounding matters the error decides, and if
that tells nothing, or one was not compared to its end, the time until which it holds.  One that meets with an obstacle
looks closer than those before."
  (let ((motion (pass-motion pass)) (other (and best (pass-motion best))))
    (cond ((null best) t)
          ((and (unfinished-p motion) (not (unfinished-p other))) nil)
          ((hopeless-p pass best) nil)
          ((or (motion-trouble motion) (motion-trouble other) (> (pass-tolerance pass) *fine*)) t)
          ((or (and (<= (min (pass-error pass) (pass-error best)) *telling*)
                    (not (cut-short-p motion))
                    (not (cut-short-p other)))
               (= (difference-good-until (pass-seen pass)) (difference-good-until (pass-seen best))))
           (< (pass-error pass) (pass-error best)))
          (t (> (way-until pass) (way-until best))))))

(defun doubt-pass (best pass)
  "BEST was preferred to the later PASS, as it claims less: that may be chance, where the motion makes very much of
roundings, and what PASS has seen counts, too."
  (let ((difference (difference-of-pass pass)))
    (when (and (not (motion-trouble (pass-motion pass)))
               (not (cut-short-p (pass-motion pass)))
               (sensitive-p difference pass *unbounded*))
      (setf (pass-error best) (max difference (pass-error best))))))

(defun hopeless-p (pass best)
  "Whether a tolerance was too fine for a single step, of a motion that was followed to the end before."
  (and best
       (obstacle-p (motion-integration (pass-motion pass)))
       (not (motion-trouble (pass-motion best)))
       (zerop (way-until pass))))

(defun way-until (pass)
  (abs (- (difference-good-until (pass-seen pass))
          (integration-start (motion-integration (pass-motion pass))))))
