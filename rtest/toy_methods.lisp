;;;; toy_methods.lisp: methods of integration, as anybody may add them.
;;;;
;;;;   method = heun        two stages, order 2 with an estimate of order 1: a formula
;;;;   method = lame        the same, but an integration that checks another does not take a step
;;;;   method = leapfrog    q and p in turns, for Hamilton's equations: steps of equal length, an option of its own

(in-package :anmech)

(needs "arithmetic/floats" "numerics/accuracy" "numerics/dag" "numerics/equal_steps" "numerics/integration"
       "numerics/methods" "numerics/motion")

;;; Heun's method

(defun begin-heun (run)
  (setf (run-work run) (list (zeros (run-n run)) (zeros (run-n run))))
  (incf (run-evaluations run))
  (funcall (run-field run) (run-in run) (first (run-work run)))
  (first (run-work run)))

(defun attempt-heun (run)
  (incf (run-evaluations run))
  (with-run (run)
    (destructuring-bind (k1 k2) (run-work run)
      (declare (type double-array k1 k2))
      (let ((worst 0d0))
        (declare (double-float worst))
        (dotimes (i n) (setf (aref in i) (+ (aref state i) (* h (aref k1 i)))))
        (setf (aref in n) (+ now h))
        (funcall field in k2)
        (dotimes (i n)
          (setf (aref next i) (+ (aref state i) (* 0.5d0 h (+ (aref k1 i) (aref k2 i)))))
          (setq worst (max worst (/ (abs (* 0.5d0 h (- (aref k2 i) (aref k1 i))))
                                    (+ (aref (run-absolute run) i) (* (control relative) (abs (aref next i))))))))
        (setf (control error) worst)))))

(defun complete-heun (run)
  "Of a step, its length and beginning and the rates at both ends are kept."
  (incf (run-evaluations run))
  (with-run (run)
    (destructuring-bind (k1 k2) (run-work run)
      (let ((kept (list now h (copy-seq state) (copy-seq k1))))
        (replace in next)
        (setf (aref in n) (+ now h))
        (funcall field in k2)
        (setf (run-work run) (list k2 k1))
        (append kept (list (copy-seq k2)))))))

(defun heun-value (kept time out n)
  (destructuring-bind (start h state k1 k2) kept
    (let ((s (- time start)))
      (dotimes (i n)
        (setf (aref out i) (+ (aref state i) (* s (+ (aref k1 i) (* 0.5d0 (/ s h) (- (aref k2 i) (aref k1 i)))))))))))

(defun heun-formula (begin)
  (make-formula :order 2 :begin begin :attempt #'attempt-heun :complete #'complete-heun :value #'heun-value
                :room (lambda (n) (+ 2 (* 3 n)))))

(register-integrator "heun" :run (lambda (task) (motion-by-formula task (heun-formula #'begin-heun))))

(defun begin-lame (run)
  (if (problem-noise (run-problem run)) (error 'arithmetic-error) (begin-heun run)))

(register-integrator "lame" :run (lambda (task) (motion-by-formula task (heun-formula #'begin-lame))))

;;; The leapfrog without its half steps

(defun leap (field in n h momenta-first)
  "One step on, in place."
  (let ((rates (zeros n)) (half (/ n 2)))
    (dolist (start (if momenta-first (list half 0) (list 0 half)))
      (funcall field in rates)
      (loop for i from start below (+ start half) do (incf (aref in i) (* h (aref rates i)))))
    (incf (aref in n) h)))

(defun leapfrog-walker (field n momenta-first start step)
  (let ((in (copy-seq start)) (taken 0))
    (flet ((go-on (in h)
             (handler-case (progn (leap field in n h momenta-first) nil)
               ((or domain-violation arithmetic-error) (condition) condition))))
      (make-walker :advance (lambda (count) (loop while (< taken count)
                                                  do (let ((trouble (go-on in step))) (when trouble (return trouble)))
                                                     (incf taken)))
                   :taken (lambda () taken)
                   :state (lambda (time out) (declare (ignore time)) (replace out in :end1 n))
                   :cost (lambda () (* 2 taken))
                   :value (lambda (states time later out)
                            (let ((there (copy-seq start)) (left (- later time)))
                              (replace there states)
                              (setf (aref there n) time)
                              (loop until (zerop left)
                                    do (let ((h (if (< (abs step) (abs left)) step left)))
                                         (go-on there h)
                                         (decf left h)))
                              (replace out there :end1 n)))))))

(defun leapfrog-motion (task)
  (let* ((problem (task-problem task)) (given (assoc 'maxima::$momenta_first (task-options task))))
    (motion-of-equal-steps task (lambda (problem start step)
                                  (leapfrog-walker (problem-field problem) (problem-n problem) (and given (cdr given))
                                                   start step)))))

(defun trouble-of-leapfrog (options)
  (let ((given (assoc 'maxima::$momenta_first options)))
    (if (and given (not (member (cdr given) '(t nil))))
        (format nil "momenta_first must be true or false, found ~a" (one-line (cdr given)))
        (step-size-trouble "leapfrog" options))))

(register-integrator "leapfrog" :kinds '("hamilton_system") :advice "to_hamilton finds one for many" :all-states t
                                :options '("step_size" "momenta_first") :check #'trouble-of-leapfrog
                                :preserves '("two_form") :run #'leapfrog-motion)
