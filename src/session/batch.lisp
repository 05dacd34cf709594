;;; anmech: a file of inputs run for somebody who wants to know, by the exit status, whether all went well.
;;;
;;; Maxima's own --batch leaves with status 0 after an error, goes on after an error of Lisp, and waits for answers to
;;; its questions.
;;;
;;; Entry points: anmech_run_batch, LEAVE-MAXIMA.

(in-package :anmech)
(needs "session/guard" "session/interposed")

(defun leave-maxima (code)
  (finish-output)
  #+gcl (si::bye code)
  #+sbcl (sb-ext:exit :code code :abort t)
  #+ecl (ext:quit code)
  #-(or gcl sbcl ecl) (progn code (maxima::$quit)))

(defun completed-p (file)
  "Evaluate the inputs of FILE as Maxima's batch does; false after the first error."
  (handler-case
      (with-open-file (stream file)
        (let ((maxima::$load_pathname (namestring (truename file))) (*read-base* 10))
          ;; at the end of a file there is nothing thrown, or nil; by errors, something
          (member (catch 'maxima::macsyma-quit (maxima::continue :stream stream :batch-or-demo-flag :batch))
                  '(nil maxima::$done))))
    (error (condition) (format t "~&~a~%" condition) nil)))

(maxima::defmfun maxima::$anmech_run_batch (file)
  "anmech_run_batch(file): runs FILE and leaves Maxima, with status 0, or 1 after an error."
  (setq *answering* #'no-question)
  (interpose 'maxima::retrieve '*answering*)
  (let ((completed (completed-p file)))
    (unless completed (format t "~&anmech_batch: stopped by an error in ~a~%" file))
    (leave-maxima (if completed 0 1))))
