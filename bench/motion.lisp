;;; CPU milliseconds of the parts of a motion, as Maxima functions for measurements.

(in-package :anmech)

(defparameter *least-batch* (max 0.05d0 (/ 30d0 internal-time-units-per-second))
  "Seconds: of a clock that ticks a hundred times a second, the least of some short times would be less than the time.")

(defun milliseconds (thunk &optional (batches 5))
  "Of a call of THUNK: the least mean of some batches, each of *LEAST-BATCH* or some more: one that is longer because
garbage was collected must not tell how many calls make a batch."
  (flet ((seconds-of (count)
           (let ((clock (get-internal-run-time)))
             (dotimes (i count) (funcall thunk))
             (/ (- (get-internal-run-time) clock) (float internal-time-units-per-second 1d0)))))
    (let ((count 1) (least 0d0))
      (loop
        (loop until (> (seconds-of count) (* 1.2d0 *least-batch*)) do (setq count (* 2 count)))
        (setq least (loop repeat batches minimize (seconds-of count)))
        (when (> least *least-batch*) (return (/ (* 1000 least) count)))
        (setq count (* 2 count))))))

(defun task-of (record accuracy)
  (let ((model (motion-model record)))
    (make-task :problem (make-problem :model model :field (model-field model) :n (motion-dimension record)
                                      :timed (model-timed-p model) :patience most-positive-fixnum
                                      :start (motion-start record)
                                      :end (motion-reached record))
               :given (map 'list #'rational (motion-start record)) :options '((maxima::$chosen . t))
               :accuracy accuracy :verify t)))

(defun task-made-by (thunk)
  "The task of the last motion that THUNK integrates."
  (let ((task nil) (make #'new-task))
    (unwind-protect
         (progn
           (setf (symbol-function 'new-task) (lambda (&rest said) (setq task (apply make said))))
           (funcall thunk))
      (setf (symbol-function 'new-task) make))
    task))

(maxima::defmfun maxima::$milliseconds_of (function)
  "milliseconds_of(f): of a call f()."
  (milliseconds (lambda () (maxima::mfuncall function))))

(defun with-series-compiled (task)
  "TASK, whose model has the code that a session compiles in the course of time."
  (let ((kernel (model-kernel (problem-model (task-problem task)))))
    (when (and (small-p kernel) (zerop (length (series-kernel-straight kernel))))
      (straight-code-for kernel (1- +room+)))
    task))

(maxima::defmfun maxima::$kernel_milliseconds (motion accuracy method)
  "kernel_milliseconds(motion, accuracy, method): [verified, one run], of all integrations of that motion with their
comparisons, and of a single run of the tolerance of the finest of them."
  (let* ((task (with-series-compiled (task-of (first (last motion)) accuracy))) (integrator (integrator-named method))
         (runs '()) (run #'integrate-by-steps))
    (unwind-protect
         (progn
           (setf (symbol-function 'integrate-by-steps)
                 (lambda (formula problem tolerance &rest more)
                   (unless (problem-noise problem)
                     (let ((kept (copy-tolerance tolerance)))
                       (setf (tolerance-absolute kept) (copy-seq (tolerance-absolute tolerance))
                             (tolerance-observer kept) nil)
                       (push (list* formula problem kept more) runs)))
                   (apply run formula problem tolerance more)))
           (motion-of-task task integrator))
      (setf (symbol-function 'integrate-by-steps) run))
    (list '(maxima::mlist)
          (milliseconds (lambda () (motion-of-task task integrator)))
          (milliseconds (lambda () (apply run (first runs)))))))

(maxima::defmfun maxima::$integrations_milliseconds (function method)
  "integrations_milliseconds(f, method): of all integrations of the motion that f() makes by that method."
  (let ((task (with-series-compiled (task-made-by (lambda () (maxima::mfuncall function)))))
        (integrator (integrator-named method)))
    (milliseconds (lambda () (motion-of-task task integrator)) 3)))
