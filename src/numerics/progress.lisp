;;; anmech: how long a computation has taken, and a line that tells how far a long one is.
;;;
;;; Entry points: SECONDS-SINCE; PROGRESS-LINE, TELLING, PROGRESS-OF-PASS; anmech_line_of_progress, anmech_show_part,
;;; anmech_show_stage.

(in-package :anmech)

(defun seconds-since (start)
  "Since the real time START was taken by get-internal-real-time."
  (/ (float (- (get-internal-real-time) start) 1d0) internal-time-units-per-second))

(defun progress-of-pass (progress pass)
  (lambda (what part) (funcall progress (format nil "~apass ~d" what pass) part)))

(defun telling (progress what)
  "What an integration is to call with the part of the way that is done."
  (and progress (lambda (part) (funcall progress what part))))

(defun progress-line (mode &optional (verb "integrate_motion"))
  "A function (what part) that shows, after two seconds, how far VERB is; without arguments, that it is over.  PART is
nil where nobody knows how long the way is.
MODE is true, false, or auto: a line for somebody who waits at a prompt, none while a file is read."
  (let ((start (get-internal-real-time)) (terminal :unknown) (shown nil))
    (flet ((show (text)
             (cond ((fboundp 'maxima::$wxstatusbar) (funcall 'maxima::$wxstatusbar text))
                   (terminal (write-char #\Return) (format t "~60a" text) (write-char #\Return))
                   ((string/= text "") (format t "~a~%" text)))
             (finish-output)))
      (and mode
           (or (eq mode t) (null maxima::$load_pathname))
           (lambda (&optional what part)
             (when (and what (> (seconds-since start) 2))
               (when (eq terminal :unknown) (setq terminal (terminal-p)))
               (let ((now (list what (cond ((null part) nil)
                                           (terminal (floor (* 100 part)))
                                           (t (* 10 (floor (* 10 part))))))))
                 (when (and (or terminal (eq mode t)) (not (equal now shown)))
                   (setq shown now)
                   (show (format nil "~a: ~{~a~^, ~}" verb
                                 (remove nil (list (and (string/= what "") what)
                                                   (and part (format nil "~d %" (second now))))))))))
             (when (and shown (null what)) (show "")))))))

(maxima::defmfun maxima::$anmech_line_of_progress (verb mode)
  "anmech_line_of_progress(verb, mode): what anmech_show_part takes."
  (progress-line mode verb))

(maxima::defmfun maxima::$anmech_show_part (line part)
  "anmech_show_part(line, part): how far it is; false: that it is over."
  (when line (if part (funcall line "" part) (funcall line)))
  'maxima::$done)

(maxima::defmfun maxima::$anmech_show_stage (line text)
  "anmech_show_stage(line, text): what a search of unknown length has come to."
  (when line (funcall line text nil))
  'maxima::$done)
