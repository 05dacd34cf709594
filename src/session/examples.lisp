;;; anmech: the inputs of an example, as the manual shows them:
;;;
;;;     (%i1) coordinates([x])$
;;;     (%i2) energy(lagrange_system(m*diff(x,t)^2/2
;;;             - k*x^2/2, [x]));
;;;     (%o2) (k*x^2+m*('diff(x,t,1))^2)/2
;;;
;;; An input may go on over several lines, up to its ; or $.  What follows it, up to the next input, is its output.
;;;
;;; Entry points: STARTS-WITH, TRIMMED, JOINED, INPUT-LINE-P, COMPLETE-INPUT-P, INPUT-TEXT, PARSED.

(in-package :anmech)

(defun starts-with (prefix text)
  (member (mismatch prefix text) (list nil (length prefix))))

(defun trimmed (text)
  (string-trim '(#\Space #\Newline #\Tab) text))

(defun joined (lines)
  (format nil "~{~a~^~%~}" lines))

(defun input-line-p (line) (starts-with "(%i" line))

(defun input-text (lines)
  "What stands after the label of the first of LINES, up to the end of the last."
  (let ((text (joined lines)))
    (trimmed (subseq text (1+ (position #\) text))))))

(defun complete-input-p (lines)
  (let ((text (input-text lines)))
    (and (string/= text "") (find (char text (1- (length text))) ";$") t)))

(defun parsed (text)
  "The one expression that TEXT holds, and whether it ends with $."
  (with-input-from-string (stream text)
    (let* ((maxima::*mread-prompt* "") (*read-base* 10) (form (maxima::mread stream nil)))
      (declare (special maxima::*mread-prompt*))
      (values (third form) (eq (caar form) 'maxima::nodisplayinput)))))
