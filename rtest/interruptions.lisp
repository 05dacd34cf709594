;;;; interruptions.lisp: what rtest_interruptions.mac asks.  Every interruption is a true one, SIGINT, sent to this very
;;;; Maxima as Control-C and front ends do.  On ECL it is what its own handler of that signal does with a Maxima of one
;;;; thread: the handler counts the threads, now and then wrongly, and then asks on the terminal which is meant.
;;;;
;;;;   interrupted_at_call(k, 'function, expr)   the value of expr, interrupted in the kth call of a function of a
;;;;                                             module or the kernel
;;;;   interrupted_at_step(k, expr)              the same in the kth step that is tried of a motion by method dop853
;;;;   interrupted_at_leap(k, expr)              the same before the kth state that steps of equal length keep
;;;;   interrupted_beside(command)               whether a command that goes on beside the session is over when that was
;;;;                                             interrupted; it is to make the file $mark when it begins, and remove
;;;;                                             it when it is asked to end
;;;;   status_beside(command)                    the status of such a command
;;;;   interruptions_sent()                      how many were sent

(in-package :anmech)

(mapc #'load-kernel '("session/processes" "numerics/accuracy" "numerics/equal_steps" "numerics/methods"))
(integrators)

(defvar *sent* 0)

(defun interrupt-soon ()
  "In the background, for system keeps signals from who waits for it."
  (incf *sent*)
  #+ecl
  (let ((here mp:*current-process*))
    (mp:process-run-function 'interruption
                             (lambda ()
                               (sleep 0.2)
                               (mp:interrupt-process here #'si::single-threaded-terminal-interrupt))))
  #-ecl
  (maxima::$system "(sleep 0.2; kill -INT $PPID) > /dev/null 2>&1 &"))

(defun wait-for-interruption (seconds)
  (let ((start (get-internal-real-time)))
    (loop until (or (interrupted-p) (> (seconds-since start) seconds))
          do (sleep 0.01))))

(defun interrupting-at (k function)
  "FUNCTION, whose Kth call is interrupted."
  (let ((count 0))
    (lambda (&rest arguments)
      (when (= (incf count) k)
        (interrupt-soon)
        (wait-for-interruption 60))
      (apply function arguments))))

(maxima::defmspec maxima::$interrupted_at_call (form)
  (destructuring-bind (k name expression) (rest form)
    (let* ((symbol (maxima::meval name)) (definition (definition-of symbol)))
      (flet ((what-is-done () (if definition (definition-body definition) (symbol-function symbol)))
             (do-instead (function)
               (if definition
                   (setf (definition-prepared definition) function)
                   (setf (symbol-function symbol) function))))
        (let ((before (what-is-done)))
          (unwind-protect
               (progn (do-instead (interrupting-at (maxima::meval k) before))
                      (maxima::meval expression))
            (do-instead before)))))))

(maxima::defmspec maxima::$interrupted_at_step (form)
  (destructuring-bind (k expression) (rest form)
    (let ((attempt (formula-attempt *dop853*)))
      (unwind-protect
           (progn (setf (formula-attempt *dop853*) (interrupting-at (maxima::meval k) attempt))
                  (maxima::meval expression))
        (setf (formula-attempt *dop853*) attempt)))))

(maxima::defmspec maxima::$interrupted_at_leap (form)
  (destructuring-bind (k expression) (rest form)
    (let ((advance (symbol-function 'advance-interruptibly)))
      (unwind-protect
           (progn (setf (symbol-function 'advance-interruptibly) (interrupting-at (maxima::meval k) advance))
                  (maxima::meval expression))
        (setf (symbol-function 'advance-interruptibly) advance)))))

;;; The session alone is interrupted, as front ends do it.
(maxima::defmfun maxima::$interrupted_beside (command)
  (let* ((stem (format nil "~a/beside" (string-right-trim "/" maxima::$maxima_tempdir)))
         (mark (format nil "~a.mark" stem))
         (sent nil) (begun nil)
         (value (call-until-interrupted
                 (lambda ()
                   (status-beside (format nil "mark=~a; ~a" (shell-word mark) command) stem
                                  (lambda ()
                                    (when (and (not sent) (probe-file mark))
                                      (setq begun t sent t)
                                      (interrupt-soon))))))))
    (and begun (eq value :interrupted) (not (probe-file mark)))))

(maxima::defmfun maxima::$status_beside (command)
  (status-beside command (format nil "~a/beside" (string-right-trim "/" maxima::$maxima_tempdir)) (lambda () nil)))

(maxima::defmfun maxima::$interruptions_sent () *sent*)
