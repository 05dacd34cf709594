;;; anmech: workers beside the session, which waits for them and tells how far they are.
;;;
;;; Entry points: anmech_status_of_workers, anmech_is_worked_on.

(in-package :anmech)
(needs "session/processes" "session/whole_files" "numerics/progress" "sweeps/chunks")

(defun file-there-p (folder number)
  (probe-file (maxima::$anmech_chunk_file folder number)))

(defun showing-how-many (folder missing line)
  "A function that counts, once a second, which of the chunks MISSING are there.  They are begun in their order: the
first of those that are left are looked for.  A damaged one has a file from the beginning."
  (let* ((left (remove-if (lambda (number) (file-there-p folder number)) missing))
         (count (length left))
         (last (get-internal-real-time)))
    (lambda ()
      (when (and line left (> (seconds-since last) 1))
        (setq last (get-internal-real-time))
        (let ((most (min 200 (length left))))
          (setq left (append (remove-if (lambda (number) (file-there-p folder number)) (subseq left 0 most))
                             (nthcdr most left))))
        (funcall line "" (/ (- count (length left)) count))))))

(maxima::defmfun maxima::$anmech_status_of_workers (command folder missing line)
  "anmech_status_of_workers(command, folder, [number, ...], line): the status with which the command ends that computes
these chunks in the folder and ends with the session; false if nobody knows.  LINE, or false, shows how far it is."
  (unwind-protect
       (status-beside command (passing-name (format nil "~a/workers" folder))
                      (showing-how-many folder (rest missing) line))
    (maxima::$anmech_show_part line nil)))

(maxima::defmfun maxima::$anmech_is_worked_on (folder)
  "anmech_is_worked_on(folder): whether workers compute in it, as far as this machine knows, and do not end within five
seconds, as those do whose session is gone."
  (not (maxima::$anmech_succeeds
        (format nil "cd ~a && { ! [ -e at_work ] || ! command -v flock > /dev/null || flock -w 5 at_work true; } ~
                     2> /dev/null"
                (shell-word folder)))))
