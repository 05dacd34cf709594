;;; What chain.mac measures with.

(in-package :anmech)

(defun processor-seconds ()
  "Of this process and of those it has waited for, the C compiler's."
  #+gcl (with-open-file (stream "/proc/self/stat")
          (let* ((line (read-line stream))
                 (fields (read-from-string
                          (format nil "(~a)" (subseq line (+ 4 (position #\) line :from-end t)))))))
            (/ (reduce #'+ (subseq fields 10 14)) 100d0)))
  #-gcl (/ (get-internal-run-time) (float internal-time-units-per-second 1d0)))

(maxima::defmfun maxima::$processor_seconds () (processor-seconds))

(maxima::defmfun maxima::$evaluation_nanoseconds (model)
  "The least of seven measurements, of a tenth of a second each."
  (let* ((field (model-field model))
         (in (doubles (loop for k below (length (model-inputs model)) collect (sin (float k 1d0)))))
         (out (zeros (model-dimension model)))
         (count 100))
    (declare (type function field))
    (flet ((seconds ()
             (let ((start (get-internal-run-time)))
               (dotimes (k count) (funcall field in out))
               (/ (- (get-internal-run-time) start) (float internal-time-units-per-second 1d0)))))
      (loop while (< (seconds) 0.1d0) do (setq count (* 2 count)))
      (/ (* 1d9 (loop repeat 7 minimize (seconds))) count))))

(maxima::defmfun maxima::$tell_costs (name n costs reference)
  (destructuring-bind (derived compiled evaluation) (rest costs)
    (format t "~9a n = ~3d: derived ~,2f s, compiled ~,2f s, evaluation ~,2f us" name n derived compiled
            (/ evaluation 1000))
    (when reference
      (destructuring-bind (derived-too compiled-too evaluation-too) (rest reference)
        (format t "; by that of Hamilton's form ~,2f, ~,2f, ~,2f"
                (/ derived (max derived-too 0.01)) (/ compiled (max compiled-too 0.01))
                (/ evaluation evaluation-too))))
    (terpri)))
