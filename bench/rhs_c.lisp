;;; Times right-hand sides in Lisp and writes them as C; see rhs_c.sh.

(in-package :anmech)

(defun nanoseconds-per-call (field in out)
  "The least of ten measurements of the processor's time, of a fifth of a second each."
  (let ((repeat (quietly-compiled '(lambda (field in out count)
                                     (declare (fixnum count) (type function field) (optimize (speed 3) (safety 0)))
                                     (do ((k 0 (the fixnum (1+ k))))
                                         ((>= k count))
                                       (declare (fixnum k))
                                       (funcall field in out)))))
        (count 1000))
    (flet ((seconds ()
             (let ((start (get-internal-run-time)))
               (funcall repeat field in out count)
               (/ (float (- (get-internal-run-time) start) 1d0) internal-time-units-per-second))))
      (loop until (> (seconds) 0.2d0) do (setq count (* 2 count)))
      (/ (* 1d9 (loop repeat 10 minimize (seconds))) count))))

(defun some-numbers (count)
  "COUNT different numbers between 1 and 2, the same in C."
  (doubles (loop for k from 1 to count collect (+ 1d0 (/ k 32d0)))))

(defun solving-field (expressions inputs size)
  "The field of SIZE coordinates and velocities, the first of INPUTS: EXPRESSIONS are the entries of A and b."
  (flet ((part (start count) (subseq expressions start (+ start count))))
    (model-field (make-motion-model (subseq inputs 0 (* 2 size)) (subseq inputs size (* 2 size)) (nth (* 2 size) inputs)
                                    (nthcdr (1+ (* 2 size)) inputs) (loop repeat size collect (gensym))
                                    (loop for row below size collect (part (* row size) size))
                                    (part (* size size) size)))))

(defun c-function (program inputs name)
  "The lines of void NAME(const double *in, double *out), as export_code writes them."
  (let ((c (language-named 'maxima::$c)))
    (flet ((elements (array list) (loop for place below (length list) collect (element-text c array place))))
      (append (list "#include <math.h>" (format nil "void ~a(const double *restrict in, double *restrict out)" name) "{")
              (program-statements program (elements "in" inputs) (elements "out" (program-results program)) c)
              (list "}")))))

(maxima::defmfun maxima::$measure_right_hand_sides (target problems)
  "measure_right_hand_sides(file, [[name, [expr, ...], [variable, ...], size], ...]): print times, write C to the file.
With a size of 0 the expressions are the rates; otherwise the entries of A and b in A u = b."
  (with-open-file (stream target :direction :output :if-exists :supersede)
    (dolist (problem (rest problems) 'maxima::$done)
      (destructuring-bind (name (mlist . expressions) (mlist-too . inputs) size) (rest problem)
        (declare (ignore mlist mlist-too))
        (multiple-value-bind (function program) (compile-expressions expressions inputs)
          (let ((field (if (zerop size) function (solving-field expressions inputs size))))
            (format t "rhs ~a ~,3f ~d~%" name
                    (nanoseconds-per-call field (some-numbers (length inputs)) (some-numbers (length expressions)))
                    (program-length program))))
        (format stream "~{~a~%~}" (c-function (expressions-program expressions inputs) inputs name))))))
