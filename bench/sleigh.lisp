;;; CPU seconds of one integration, without what the call around it does, as a Maxima function for measurements.

(in-package :anmech)

(maxima::defmfun maxima::$integration_seconds (motion t1 accuracy verify times)
  "integration_seconds(motion, t1, accuracy, verify, times): of that motion again; the mean of so many runs."
  (let* ((record (first (last motion))) (model (motion-model record))
         (problem (make-problem :model model :field (model-field model) :patience most-positive-fixnum
                                :n (motion-dimension record)
                                :start (motion-start record) :end t1))
         (task (make-task :problem problem :given (map 'list #'rational (motion-start record)) :accuracy accuracy
                          :verify verify :max-steps 1000000))
         (run (integrator-run (integrator-named 'maxima::$dop853)))
         (clock (get-internal-run-time)))
    (dotimes (i times) (funcall run task))
    (/ (- (get-internal-run-time) clock) (* 1d0 times internal-time-units-per-second))))
