;;; anmech: many motions of one system, several at a time.
;;;
;;; With simd = true, Taylor's method is compiled for the system in C (lanes.lisp), and computes motions in the lanes of
;;; the processor's registers; no more is known of each than the state at its end.  Motions that do not come to their
;;; ends there, because of a singularity, a root that vanishes or what only a closer look may tell, are integrated one
;;; by one as without it, which also finds the sentence for them.
;;;
;;; Where time itself leads through what may be a pulse, steps are as short as what is looked at for pulses else
;;; (unseen.lisp).
;;;
;;; Entry point: MOTIONS-IN-LANES.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/compiled_c" "numerics/integration"
       "numerics/lanes" "numerics/model" "numerics/motion" "numerics/passes" "numerics/series_kernel"
       "numerics/series_program" "numerics/unseen" "numerics/weights")

(defun trouble-in-lanes (task kept)
  "Why the motions that TASK is one of cannot be computed in lanes, a sentence; nil if they can.  KEPT: whether more is
asked for than their ends."
  (let* ((model (problem-model (task-problem task))) (series (model-series-program model)))
    (cond ((task-verify task) "simd = true needs verify = false: such motions are not verified")
          (kept "with simd = true nothing is known of motions but their ends: there are no samples and no events")
          ((problem-projection (task-problem task)) "simd = true does not go together with project")
          ((or (model-surfaces model) (some #'decides-p (series-program-instructions series)))
           "simd = true needs equations without kinks such as abs, signum or max")
          ((> (sums-of-products series) *most-sums-in-lanes*)
           (format nil "simd = true takes equations of up to ~d products, these have ~d" *most-sums-in-lanes*
                   (sums-of-products series))))))

(defparameter *most-sums-in-lanes* 500 "To compile more takes minutes.")
(defparameter *most-steps-in-lanes* 200000 "Motions of more are integrated one by one, where they can be interrupted.")

(defun decides-p (instruction)
  (member (first instruction) '(:absolute :sign :floor :larger :smaller)))

(defun motions-in-lanes (pattern kept kernel order steep)
  "A function of a list of tasks, of the same model as the task PATTERN, that gives the list of their motions, nil of
those that have not come to their ends.  ORDER is a function of the tolerance that gives that of the polynomials of
KERNEL; STEEP as in LANES-PROGRAM."
  (let ((trouble (trouble-in-lanes pattern kept)))
    (when trouble (complain "~a" trouble)))
  (let* ((problem (task-problem pattern)) (part (max (/ (task-accuracy pattern) 10) *finest*))
         (program (program-for kernel (funcall order part) (length (problem-start problem)) steep))
         (longest (longest-in-lanes problem kernel))
         (most-steps (min *most-steps-in-lanes* (or (task-max-steps pattern) *most-steps-in-lanes*))))
    (lambda (tasks)
      (run-compiled program
                    (lambda (stream) (tell-tasks tasks part most-steps longest stream))
                    (lambda (stream) (mapcar (lambda (task) (motion-of-lane task stream)) tasks))
                    (* (length tasks) (1+ (* 2 (problem-n problem))))))))

(defun program-for (kernel order inputs steep)
  "The program for KERNEL and ORDER."
  (or (cdr (assoc order (series-kernel-programs kernel)))
      (let ((program (make-c-program :source (lambda () (lanes-program kernel order inputs steep)))))
        (push (cons order program) (series-kernel-programs kernel))
        program)))

(defun tell-tasks (tasks part most-steps longest stream)
  (let ((end (problem-end (task-problem (first tasks)))))
    (write-byte (length tasks) stream)
    (write-byte most-steps stream)
    (write-double end stream)
    (write-double part stream)
    (write-double longest stream)
    (dolist (task tasks)
      (let* ((problem (task-problem task))
             (tolerance (growing-tolerance (first-weights problem) part problem)))
        (write-doubles (problem-start problem) stream)
        (write-doubles (tolerance-absolute tolerance) stream)))))

(defun write-doubles (numbers stream)
  (declare (type double-array numbers))
  (dotimes (place (length numbers)) (write-double (aref numbers place) stream)))

(defun motion-of-lane (task stream)
  (let* ((problem (task-problem task)) (model (problem-model problem)) (start (problem-start problem))
         (come (= 1 (read-byte stream))) (n (problem-n problem)) (state (zeros n)))
    (declare (type double-array state start))
    (dotimes (i n) (setf (aref state i) (read-double stream)))
    (and come
         (let ((end (problem-end problem)))
           (make-motion :model model :start start :reached end :unverified t
                        :integration (make-integration :times (coerce (list (aref start n) end) 'double-array)
                                                       :states (subseq start 0 n) :steps #() :final state
                                                       :accepted 0 :rejected 0 :evaluations 0 :status :ok))))))

(defun longest-in-lanes (problem kernel)
  "The longest step that is taken."
  (let ((way (abs (- (problem-end problem) (problem-time problem)))))
    (if (and (problem-timed problem) (some #'may-hide-p (series-kernel-instructions kernel)))
        (* 5 (/ way *looks-for-pulses*))
        way)))

(defun may-hide-p (instruction)
  "Whether the series of INSTRUCTION may tell nothing of what comes: it may have poles or branches next to the way, or
fall steeply."
  (not (or (member (first instruction) '(:add :subtract :negate :shift :scale :over :fixed :multiply :square))
           (member (second instruction) '(:sin :cos)))))
