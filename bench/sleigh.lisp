;;; CPU seconds of one integration, without what the call around it does, as a Maxima function for measurements.

(in-package :anmech)

(maxima::defmfun maxima::$integration_seconds (motion t1 accuracy verify times)
  "integration_seconds(motion, t1, accuracy, verify, times): of that motion again; the mean of so many runs."
  (let* ((record (first (last motion))) (model (motion-model record)) (start (motion-start record))
         (clock (get-internal-run-time)))
    (dotimes (i times) (integrate-motion model start start t1 accuracy verify 1000000 nil))
    (/ (- (get-internal-run-time) clock) (* 1d0 times internal-time-units-per-second))))
