;;; anmech: other programs that a verb makes use of, through the shell.
;;;
;;; Entry points: PROCESS-MARK, SHELL-WORD, ENDS-WELL, STATUS-BESIDE; $anmech_succeeds, $anmech_shell_word,
;;; $anmech_maxima_command, $anmech_root_directory, $anmech_lisp_name, $anmech_objects_directory, $anmech_host_word.

(in-package :anmech)
(needs "session/patience")

(defvar *interruptions-handed-on* nil "Whether a command that is run is interrupted, too, when the session is.")

(maxima::defmfun maxima::$anmech_succeeds (command)
  "anmech_succeeds(command): runs a command of the shell, and whether it ends well."
  #+sbcl (let ((process nil))
           (unwind-protect
                (progn (setq process (sb-ext:run-program "/bin/sh" (list "-c" command)
                                                         :input nil :output t :error t :wait nil))
                       (let ((*when-noted* (and *interruptions-handed-on*
                                                (lambda () (sb-ext:process-kill process 2 :process-group)))))
                         (sb-ext:process-wait process))
                       (eql 0 (sb-ext:process-exit-code process)))
             (when (and process (sb-ext:process-alive-p process))
               (sb-ext:process-kill process 15 :process-group))))
  #+gcl (multiple-value-bind (status signal) (si:system command)
          (when (eql signal 2) (note-interruption))
          (and (eql 0 status) (eql 0 signal)))
  #+ecl (eql 0 (ext:system command))
  #-(or sbcl gcl ecl) (error "this Lisp runs no other programs: ~a" command))

(defun ends-well (command mark)
  "How a command of the shell ends that an interruption of the session ends, too: t, nil, or :interrupted, which is
noted.  MARK is the name of a file that may be made for this."
  (let ((well (let ((*interruptions-handed-on* t))
                (maxima::$anmech_succeeds (format nil "mark=~a; trap ': > \"$mark\"; exit 1' INT; ~a"
                                                  (shell-word mark) command)))))
    (cond (well t)
          ((probe-file mark) (delete-file mark) (note-interruption) :interrupted)
          ((interrupted-p) :interrupted))))

;;; A command that the session waits for while it goes on beside it.  A shell of its own watches both: the command ends
;;; when the session is interrupted, by whatever signal to whichever process, and when the session is gone.

(defun watching-script (command stem)
  "COMMAND, which may ask $watcher for the process that watches it, is asked to end by SIGTERM, again and again, as it
may not listen from its first moment on, and has four seconds for that."
  (format nil "
    stem=~a; session=~d; watcher=$$
    stop() {
      for turn in 1 2 3 4 5 6 7 8; do kill \"$program\" || return; sleep 0.5; done
      kill -9 \"$program\"
    }
    trap '' INT
    ( ~a
    ) &
    program=$!
    trap stop TERM HUP
    { trap - TERM HUP; while kill -0 $session; do sleep 1; done; kill $watcher; } &
    guard=$!
    wait \"$program\"
    echo $? > \"$stem.new\"
    kill $guard
    mv -f \"$stem.new\" \"$stem.status\""
          (shell-word stem) (process-number) command))

(defun status-in (file)
  "The number in FILE; nil as long as it is not there."
  (with-open-file (stream file :if-does-not-exist nil)
    (and stream (parse-integer (read-line stream) :junk-allowed t))))

(defun status-beside (command stem tick)
  "The status with which a command of the shell ends that goes on beside the session, and ends with it, or when it is
interrupted; nil if nobody knows.  TICK is a function that is called some times a second meanwhile.  The command should
end by `exec PROGRAM', which SIGTERM ends.  STEM begins the names of files that are made for this and removed."
  (let ((status-file (format nil "~a.status" stem)) (process-file (format nil "~a.process" stem)) (over nil))
    (unwind-protect
         (progn
           (maxima::$anmech_succeeds (format nil "sh -c ~a < /dev/null > /dev/null 2>&1 & echo $! > ~a"
                                             (shell-word (watching-script command stem)) (shell-word process-file)))
           (loop for turn from 1
                 for status = (status-in status-file)
                 until (or status
                           (and (zerop (mod turn 50))   ; who watches may have been killed
                                (not (maxima::$anmech_succeeds (format nil "kill -0 $(cat ~a) 2> /dev/null"
                                                                       (shell-word process-file))))))
                 do (sleep 0.1)
                    (funcall tick)
                 finally (setq over t)
                         (return (or status (status-in status-file)))))
      (unless over
        (maxima::$anmech_succeeds
         (format nil "kill $(cat ~a); for turn in 1 2 3 4 5 6 7 8 9 10 11 12; do [ ! -e ~a ] || break; sleep 0.5; done"
                 (shell-word process-file) (shell-word status-file))))
      (maxima::$anmech_succeeds (format nil "rm -f ~a ~a" (shell-word status-file) (shell-word process-file))))))

(defun shell-word (text)
  "TEXT as one word of the shell, whatever it holds."
  (with-output-to-string (out)
    (write-char #\' out)
    (loop for char across text
          do (if (char= char #\') (write-string "'\\''" out) (write-char char out)))
    (write-char #\' out)))

(maxima::defmfun maxima::$anmech_shell_word (text)
  "anmech_shell_word(text): as one word of the shell."
  (coerce (shell-word text) 'simple-string))

(maxima::defmfun maxima::$anmech_maxima_command ()
  "anmech_maxima_command(): the command that starts a Maxima like this one."
  (let ((program (format nil "~a/bin/maxima" maxima::*maxima-prefix*)))
    (format nil "~a -l ~a -u ~a" (if (probe-file program) (shell-word program) "maxima")
            maxima::*maxima-lispname* maxima::*autoconf-version*)))

(maxima::defmfun maxima::$anmech_root_directory ()
  "anmech_root_directory(): where the package lies, with a slash at its end."
  (subseq *source-directory* 0 (- (length *source-directory*) (length "src/"))))

(maxima::defmfun maxima::$anmech_objects_directory ()
  "anmech_objects_directory(): what MAXIMA_OBJDIR must be for a Maxima that is to find the kernel compiled by this one."
  (let ((directory (string-right-trim "/" (namestring maxima::$maxima_objdir))))
    ;; behind it come the versions of Maxima and Lisp, and between these the Lisp
    (loop repeat 3 do (setq directory (subseq directory 0 (position #\/ directory :from-end t))))
    (coerce directory 'simple-string)))

(maxima::defmfun maxima::$anmech_lisp_name ()
  "anmech_lisp_name(): Maxima and its Lisp, as in 5.46.0/sbcl."
  (format nil "~a/~a" maxima::*autoconf-version* maxima::*maxima-lispname*))

(defun host-name ()
  (or (machine-instance)
      (handler-case (with-open-file (stream "/proc/sys/kernel/hostname") (read-line stream))
        (error () "host"))))

(maxima::defmfun maxima::$anmech_host_word ()
  "anmech_host_word(): the letters and digits of the name of this machine."
  (coerce (remove-if-not #'alphanumericp (host-name)) 'simple-string))

(defun process-mark ()
  "HOST.PROCESS.NUMBER, which no other process has at the same time: whoever finds it can tell whether its
writer lives."
  (format nil "~a.~d.~36r" (maxima::$anmech_host_word) (process-number) (random (expt 36 8) (make-random-state t))))
